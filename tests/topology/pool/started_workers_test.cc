// Workers that systemd starts under another account than their pool's.
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/fsuid.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/processes/systemd_stand_in.h>
#include <iotcloud/tests/topology/pool/worker_fixture.h>

namespace iotcloud::topology {
namespace {

using How = WorkerEnding::How;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;
using tests::eventually;

/// systemd with the units for workers.
struct Systemd : processes::SystemdStandIn {
  Systemd(const std::string& folder, std::string user)
      : SystemdStandIn(folder, std::move(user), POOLED_PROGRAM, "--for-pool") {}
};

class StartedWorkersTest : public WorkerProcessesTest {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "only root can start processes of another user";
    chmod(folder_.c_str(), 0711);  // to the state folder
    confinement_.user = "nobody";
    starter_ = folder_ + "/starter";
  }

  static uid_t user_of(const std::string& path) {
    struct stat status {};
    return stat(path.c_str(), &status) == 0 ? status.st_uid : 0;
  }
  /// What a worker may do (pooled_program.cc).
  std::string look_around() const {
    tests::write_file(state_ + "/secret", "the pool's");
    chmod((state_ + "/secret").c_str(), 0600);
    Told told;
    const auto workers = make();
    const auto link = workers->start(order("look around"), told.events());
    return told.ending().reason;
  }
  const uid_t nobody_ = processes::find_account("nobody").user;
};

TEST_F(StartedWorkersTest, AreOfTheOtherUserAndObeyTheirPool) {
  const Systemd systemd(folder_, "nobody");
  const auto workers = make();
  const auto link = workers->start(order("run"), told_.events());
  ASSERT_TRUE(told_.runs());
  EXPECT_EQ(user_of("/proc/" + std::to_string(told_.process())), nobody_);
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
  EXPECT_THAT(told_.ending().reason, IsEmpty());
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(StartedWorkersTest, ReachNoFileOfTheirPoolAndNoWorkersSocketAndChangeNothingInTheirFolder) {
  const Systemd systemd(folder_, "nobody");
  EXPECT_EQ(look_around(), "ptrace ") << "what is left for the filter of system calls";
}

/// SECURITY.md: a pool's thief has the pool's user, and runs what it wants in a worker.
TEST_F(StartedWorkersTest, ReadWhatTheirTopologiesFilesNameAndTheirPoolDoesSoByThemOrIfItHasTheirUser) {
  const std::string secret = folder_ + "/of-workers";
  tests::write_file(secret, "the broker's password");
  chmod(secret.c_str(), 0600);
  const uid_t pool = processes::find_account("daemon").user;
  const auto pool_reads_that_of = [&](uid_t owner) {
    EXPECT_EQ(chown(secret.c_str(), owner, static_cast<gid_t>(-1)), 0);
    setfsuid(pool);
    const bool read = std::ifstream(secret).good();
    setfsuid(geteuid());
    return read;
  };
  EXPECT_TRUE(pool_reads_that_of(pool)) << "of workers with its user";
  EXPECT_FALSE(pool_reads_that_of(nobody_));
  const Systemd systemd(folder_, "nobody");
  EXPECT_EQ(look_around(), "of-workers ptrace ");
}

TEST_F(StartedWorkersTest, DoTheSameWhereThePoolIsRootAndStartsThemItself) {
  starter_.clear();
  EXPECT_EQ(look_around(), "ptrace ");
  const auto workers = make();
  const auto link = workers->start(order("run"), told_.events());
  ASSERT_TRUE(told_.runs());
  EXPECT_EQ(user_of("/proc/" + std::to_string(told_.process())), nobody_);
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(StartedWorkersTest, SayWhyTheyCannotRunAndHowTheyEnd) {
  const Systemd systemd(folder_, "nobody");
  const auto ending_of = [&](const std::string& what) {
    Told told;
    const auto workers = make();
    const auto link = workers->start(order(what), told.events());
    return told.ending();
  };
  const auto refused = ending_of("refuse"), crashed = ending_of("crash");
  EXPECT_EQ(refused.how, How::refused);
  EXPECT_EQ(refused.reason, "there is no class");
  EXPECT_EQ(crashed.how, How::failed);
  EXPECT_THAT(crashed.reason, HasSubstr("crashed (signal 6"));
}

TEST_F(StartedWorkersTest, ThatDoNotStopAreEnded) {
  const Systemd systemd(folder_, "nobody");
  const auto workers = make();
  const auto link = workers->start(order("stay"), told_.events());
  ASSERT_TRUE(told_.runs());
  link->stop(std::chrono::milliseconds{0});
  EXPECT_THAT(told_.ending().reason, HasSubstr("was killed"));
}

TEST_F(StartedWorkersTest, ThatTakeTooMuchMemoryAreEnded) {
  limits_.memory_bytes = 1;
  const Systemd systemd(folder_, "nobody");
  const auto workers = make();
  const auto link = workers->start(order("run"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_THAT(told_.ending().reason, HasSubstr("of memory"));
}

TEST_F(StartedWorkersTest, AreFoundAndAdoptedByTheNextRunOfTheirPool) {
  const Systemd systemd(folder_, "nobody");
  int process = 0;
  {
    Told before;
    const auto workers = make();
    const auto link = workers->start(order("run"), before.events());
    ASSERT_TRUE(before.runs());
    process = before.process();
  }
  const auto workers = make();
  const auto left = workers->running();
  ASSERT_THAT(left, SizeIs(1));
  const auto link = workers->adopt(left[0], told_.events());
  ASSERT_TRUE(told_.runs());
  EXPECT_EQ(told_.process(), process);
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(StartedWorkersTest, AreEndedByTheNextRunOfTheirPoolWhenItSaysAnotherUser) {
  const Systemd systemd(folder_, "nobody");
  {
    Told before;
    const auto workers = make();
    const auto link = workers->start(order("run"), before.events());
    ASSERT_TRUE(before.runs());
  }
  confinement_.user = "daemon";
  EXPECT_THAT(make()->running(), IsEmpty());
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(StartedWorkersTest, OfAnotherUserThanTheConfigurationSaysAreEndedAndNotStartedAgain) {
  const Systemd systemd(folder_, "daemon");
  const auto workers = make();
  try {
    workers->start(order("run"), told_.events());
    FAIL() << "it was started";
  } catch (const WorkerRefused& refused) {
    EXPECT_THAT(refused.what(), HasSubstr("another user than worker_user says"));
  }
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(StartedWorkersTest, HaveTheirLogKeptWithinBoundsByTheirPool) {
  const Systemd systemd(folder_, "nobody");
  const auto workers = make();
  const auto link = workers->start(order("log much"), told_.events());
  const std::string log = WorkerProcesses::log_of(state_, order("run").place);
  EXPECT_TRUE(eventually([&] { return std::filesystem::exists(log + ".1") && user_of(log) == nobody_; }));
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(StartedWorkersTest, WithoutTheSocketThePoolDoesNotStart) {
  try {
    make();
    FAIL() << "it started";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("iotcloud-worker.socket"));
  }
}

}  // namespace
}  // namespace iotcloud::topology
