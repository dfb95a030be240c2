#pragma once

#include <cstddef>
#include <cstdint>
#include <ctime>

#include <sys/types.h>

/// Clocks and counters for the programs of bench/.
namespace iotcloud::bench {

/// Monotonic nanoseconds, of the clock that all these programs use.
inline std::int64_t now_ns() {
  timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<std::int64_t>(time.tv_sec) * 1'000'000'000 + time.tv_nsec;
}

/// Sleeps until now_ns() is `when_ns`, as precisely as the kernel can.
void sleep_until(std::int64_t when_ns);

/// Resources that this process has used since it began.
struct Usage {
  std::int64_t at_ns = 0;
  double cpu_seconds = 0;     ///< all threads, user and system
  std::int64_t switches = 0;  ///< context switches, voluntary or not
  static Usage now();
  /// 100 = one core.
  double cpu_percent_since(const Usage& before) const;
  double switches_per_second_since(const Usage& before) const;
};

/// CPU seconds, user and system, that a process has used since it began; 0 if it is gone.
double cpu_seconds_of(pid_t process);
/// Seconds in which a process's live threads could have run but had no CPU, since they began, summed; 0 if it is gone.
double waited_seconds_of(pid_t process);
/// CPU seconds that this machine has used since it booted, including interrupts and time that a hypervisor took.
double machine_cpu_seconds();

/// Resident memory of this process, bytes.
std::size_t resident_bytes();

}  // namespace iotcloud::bench
