#include <cerrno>
#include <cstring>
#include <string>

#include <fmt/format.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/worker/placement.h>

namespace iotcloud::topology {

namespace {

std::string list(const cpu_set_t& cores) {
  std::string text;
  for (int core = 0; core < CPU_SETSIZE; ++core) {
    if (CPU_ISSET(core, &cores)) text += fmt::format("{}{}", text.empty() ? "" : ", ", core);
  }
  return text;
}

void take_cores(const std::vector<int>& cores) {
  cpu_set_t allowed, wanted;
  CPU_ZERO(&allowed);
  CPU_ZERO(&wanted);
  if (sched_getaffinity(0, sizeof allowed, &allowed) != 0) {
    throw config::Error(
        fmt::format("runtime.placement.cores: the system does not say which cores this process may "
                    "use: {}",
                    std::strerror(errno)));
  }
  for (const int core : cores) {
    if (!CPU_ISSET(core, &allowed)) {
      throw config::Error(
          fmt::format("runtime.placement.cores: this process may not use core {}, only {}; name some of "
                      "these, or allow others (systemd: AllowedCPUs, containers: cpuset)",
                      core, list(allowed)));
    }
    CPU_SET(core, &wanted);
  }
  if (sched_setaffinity(0, sizeof wanted, &wanted) != 0) {
    throw config::Error(
        fmt::format("runtime.placement.cores: the system refuses it: {}; a systemd unit needs "
                    "SystemCallFilter=sched_setaffinity in a drop-in, or take its CPUAffinity= instead",
                    std::strerror(errno)));
  }
}

void lock_memory() {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  // Pages are locked as they are touched: the stacks of threads, which are large and empty, are not filled.
  if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) return;
  const std::string now = limit.rlim_cur == RLIM_INFINITY ? "unlimited" : std::to_string(limit.rlim_cur) + " bytes";
  throw config::Error(
      fmt::format("runtime.placement.lock_memory: the system refuses it: {} (the limit is {}); allow it: "
                  "LimitMEMLOCK=infinity and SystemCallFilter=@memlock in a drop-in of the systemd unit, "
                  "--ulimit memlock=-1 of a container, or ulimit -l unlimited",
                  std::strerror(errno), now));
}

void take_priority(int priority) {
  sched_param param{};
  param.sched_priority = priority;
  if (sched_setscheduler(0, SCHED_FIFO, &param) == 0) return;
  throw config::Error(
      fmt::format("runtime.placement.priority: the system refuses SCHED_FIFO at priority {}: {}; allow "
                  "it: LimitRTPRIO={}, RestrictRealtime=no and SystemCallFilter=sched_setscheduler in a "
                  "drop-in of the systemd unit, --cap-add sys_nice of a container, or ulimit -r {}",
                  priority, std::strerror(errno), priority, priority));
}

}  // namespace

void place_threads(const PlacementSettings& placement) {
  if (!placement.cores.empty()) take_cores(placement.cores);
  if (placement.lock_memory) lock_memory();
  if (placement.priority > 0) take_priority(placement.priority);
}

}  // namespace iotcloud::topology
