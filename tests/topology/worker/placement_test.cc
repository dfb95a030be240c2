#include <fstream>
#include <functional>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mman.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/worker/placement.h>

namespace iotcloud::topology {
namespace {

using testing::AllOf;
using testing::HasSubstr;

cpu_set_t cores_of_this_thread() {
  cpu_set_t cores;
  CPU_ZERO(&cores);
  sched_getaffinity(0, sizeof cores, &cores);
  return cores;
}

/// A line of what the kernel says of this process.
std::string status(const std::string& name) {
  std::ifstream file("/proc/self/status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(name + ":")) return line.substr(line.find_first_not_of(" \t", name.size() + 1));
  }
  return "";
}

/// Calls place_threads() on a thread of its own, and then `look` on one that this thread starts.
/// \return the error; empty: none.
std::string place(const PlacementSettings& placement, const std::function<void()>& look) {
  std::string error;
  std::thread placed([&] {
    try {
      place_threads(placement);
    } catch (const config::Error& refused) {
      error = refused.what();
      return;
    }
    std::thread(look).join();
  });
  placed.join();
  return error;
}

TEST(ThreadPlacement, ThreadsThatAreStartedLaterUseTheCoresThatAreNamed) {
  const cpu_set_t before = cores_of_this_thread();
  int core = 0;
  while (!CPU_ISSET(core, &before)) ++core;
  cpu_set_t there;
  EXPECT_EQ(place({.cores = {core}}, [&] { there = cores_of_this_thread(); }), "");
  EXPECT_EQ(CPU_COUNT(&there), 1);
  EXPECT_TRUE(CPU_ISSET(core, &there));
  const cpu_set_t after = cores_of_this_thread();
  EXPECT_TRUE(CPU_EQUAL(&before, &after)) << "other threads stay where they were";
}

TEST(ThreadPlacement, ACoreThatIsNotThereIsRefusedWithThoseThatAre) {
  const cpu_set_t there = cores_of_this_thread();
  int missing = CPU_SETSIZE - 1, some = 0;
  while (CPU_ISSET(missing, &there)) --missing;
  while (!CPU_ISSET(some, &there)) ++some;
  EXPECT_THAT(place({.cores = {missing}}, [] {}),
              AllOf(HasSubstr("runtime.placement.cores"), HasSubstr("core " + std::to_string(missing)),
                    HasSubstr("only " + std::to_string(some))));
}

TEST(ThreadPlacement, APriorityIsThatOfAllThreadsThatAreStartedLaterOrItIsSaidHowToAllowIt) {
  int scheduler = -1;
  sched_param param{};
  const std::string error = place({.priority = 1}, [&] {
    scheduler = sched_getscheduler(0);
    sched_getparam(0, &param);
  });
  if (error.empty()) {
    EXPECT_EQ(scheduler, SCHED_FIFO);
    EXPECT_EQ(param.sched_priority, 1);
  } else {
    EXPECT_THAT(error, AllOf(HasSubstr("runtime.placement.priority"), HasSubstr("LimitRTPRIO=1")));
  }
  EXPECT_EQ(sched_getscheduler(0), SCHED_OTHER) << "of this thread";
}

TEST(ThreadPlacement, MemoryIsLockedOrItIsSaidHowToAllowIt) {
  std::string locked;
  const std::string error = place({.lock_memory = true}, [&] { locked = status("VmLck"); });
  munlockall();
  if (error.empty()) {
#if !defined(IOTCLOUD_SANITIZED)  // sanitizers let nothing be locked
    EXPECT_NE(locked, "0 kB");
#endif
  } else {
    EXPECT_THAT(error, AllOf(HasSubstr("runtime.placement.lock_memory"), HasSubstr("LimitMEMLOCK=infinity")));
  }
}

TEST(ThreadPlacement, NothingIsChangedUnlessItIsAskedFor) {
  const cpu_set_t before = cores_of_this_thread();
  cpu_set_t there;
  int scheduler = -1;
  EXPECT_EQ(place({}, [&] { there = cores_of_this_thread(), scheduler = sched_getscheduler(0); }), "");
  EXPECT_TRUE(CPU_EQUAL(&before, &there));
  EXPECT_EQ(scheduler, SCHED_OTHER);
}

}  // namespace
}  // namespace iotcloud::topology
