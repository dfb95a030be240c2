#pragma once

#include <cstddef>
#include <cstdint>
#include <ctime>

#include <sys/types.h>

/// What the programs of bench/ measure with.
namespace iotcloud::bench {

/// Monotonic nanoseconds, of the clock that all programs here use.
inline std::int64_t now_ns() {
  timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<std::int64_t>(time.tv_sec) * 1'000'000'000 + time.tv_nsec;
}

/// Sleeps until now_ns() is `when_ns`, as precisely as the kernel can.
void sleep_until(std::int64_t when_ns);

/// What this process has used since it began.
struct Usage {
  std::int64_t at_ns = 0;
  double cpu_seconds = 0;     ///< all threads, user and system
  std::int64_t switches = 0;  ///< context switches, of its own will or not
  static Usage now();
  /// 100 = one core.
  double cpu_percent_since(const Usage& before) const;
  double switches_per_second_since(const Usage& before) const;
};

/// CPU seconds, user and system, that a process has used since it began. 0: it is gone.
double cpu_seconds_of(pid_t process);
/// Seconds for which threads of a process could have run and had no CPU, since they began; all that live are added up.
/// 0: it is gone.
double waited_seconds_of(pid_t process);
/// CPU seconds that all of this machine has used since it booted, interrupts and what a hypervisor took included.
double machine_cpu_seconds();

/// Resident memory of this process, bytes.
std::size_t resident_bytes();

}  // namespace iotcloud::bench
