#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <system_error>

#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

void sleep_until(std::int64_t when_ns) {
  thread_local const int exact = prctl(PR_SET_TIMERSLACK, 1UL);  // without it every sleep ends 50 us late
  (void)exact;
  timespec time;
  time.tv_sec = when_ns / 1'000'000'000;
  time.tv_nsec = when_ns % 1'000'000'000;
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) != 0) {
  }
}

Usage Usage::now() {
  rusage used;
  getrusage(RUSAGE_SELF, &used);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_usec) * 1e-6;
  };
  return {now_ns(), seconds(used.ru_utime) + seconds(used.ru_stime), used.ru_nvcsw + used.ru_nivcsw};
}

double Usage::cpu_percent_since(const Usage& before) const {
  return 100 * (cpu_seconds - before.cpu_seconds) / (static_cast<double>(at_ns - before.at_ns) * 1e-9);
}

double Usage::switches_per_second_since(const Usage& before) const {
  return static_cast<double>(switches - before.switches) / (static_cast<double>(at_ns - before.at_ns) * 1e-9);
}

namespace {

/// The text of a file below /proc; empty when it cannot be read.
std::string read_text(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

double ticks_to_seconds(double ticks) {
  static const double a_second = static_cast<double>(sysconf(_SC_CLK_TCK));
  return ticks / a_second;
}

}  // namespace

double cpu_seconds_of(pid_t process) {
  clockid_t clock{};
  timespec used{};
  if (clock_getcpuclockid(process, &clock) != 0 || clock_gettime(clock, &used) != 0) return 0;
  return static_cast<double>(used.tv_sec) + static_cast<double>(used.tv_nsec) * 1e-9;
}

double waited_seconds_of(pid_t process) {
  double nanoseconds = 0;
  std::error_code gone;
  const std::filesystem::path threads = "/proc/" + std::to_string(process) + "/task";
  for (auto thread = std::filesystem::directory_iterator(threads, gone);
       !gone && thread != std::filesystem::directory_iterator(); thread.increment(gone)) {
    unsigned long long waited = 0;
    if (std::sscanf(read_text(thread->path() / "schedstat").c_str(), "%*u %llu", &waited) == 1) {
      nanoseconds += static_cast<double>(waited);
    }
  }
  return nanoseconds * 1e-9;
}

double machine_cpu_seconds() {
  const std::string text = read_text("/proc/stat");
  unsigned long user = 0, nice = 0, system = 0, interrupts = 0, soft = 0, stolen = 0;
  if (std::sscanf(text.c_str(), "cpu %lu %lu %lu %*u %*u %lu %lu %lu", &user, &nice, &system, &interrupts, &soft,
                  &stolen) != 6) {
    return 0;
  }
  return ticks_to_seconds(static_cast<double>(user + nice + system + interrupts + soft + stolen));
}

std::size_t resident_bytes() {
  unsigned long size = 0, resident = 0;
  if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%lu %lu", &size, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  return resident * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}

}  // namespace iotcloud::bench
