#include <filesystem>
#include <fstream>

#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/processes/vitals.h>

namespace iotcloud::processes {

using std::chrono::duration_cast;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

/// Share of the time since a thread last slept by which the kernel's accounting may be wrong.
constexpr double rest_share = 0.1;
constexpr nanoseconds rest_tolerance = milliseconds{100};
constexpr double mebibyte = 1024.0 * 1024.0;

/// Reads how long the thread has run in all (`ran`), and how long it has run or waited for a processor (`busy`), from
/// the first two numbers of schedstat.
bool read_busy(const std::filesystem::path& thread, nanoseconds& ran, nanoseconds& busy) {
  std::int64_t running = 0, waiting = 0;
  if (!(std::ifstream(thread / "schedstat") >> running >> waiting)) return false;
  ran = nanoseconds(running);
  busy = nanoseconds(running + waiting);
  return true;
}

}  // namespace

Vitals::Vitals(std::string folder, VitalLimits limits) : folder_(std::move(folder)), limits_(limits) {}

std::string Vitals::examine(Instant now) {
  std::uint64_t pages = 0, resident = 0;
  if (!(std::ifstream(folder_ + "/statm") >> pages >> resident)) return "";
  memory_bytes_ = resident * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  if (limits_.memory_bytes > 0 && memory_bytes_ > limits_.memory_bytes) {
    return fmt::format("took {:.0f} MiB of memory, more than its limit of {:.0f} MiB",
                       static_cast<double>(memory_bytes_) / mebibyte,
                       static_cast<double>(limits_.memory_bytes) / mebibyte);
  }
  return limits_.spin.count() > 0 ? spinning_thread(now) : "";
}

std::string Vitals::spinning_thread(Instant now) {
  std::string spinning;
  std::error_code error;
  for (const auto& folder : std::filesystem::directory_iterator(folder_ + "/task", error)) {
    nanoseconds ran{0}, busy{0};
    if (!read_busy(folder.path(), ran, busy)) continue;
    auto& thread = threads_.try_emplace(folder.path().filename(), Thread{now, busy, ran, true}).first->second;
    thread.seen = true;
    const nanoseconds elapsed = now - thread.since;
    const nanoseconds rested = elapsed - (busy - thread.busy);
    if (rested > duration_cast<nanoseconds>(elapsed * rest_share) + rest_tolerance) {
      thread.since = now;
      thread.busy = busy;
      thread.ran = ran;
    } else if (elapsed >= limits_.spin && ran - thread.ran >= limits_.spin / 2) {
      std::string name;
      std::getline(std::ifstream(folder.path() / "comm"), name);
      spinning = fmt::format("spun: its thread {} has not slept for {} ms", name,
                             duration_cast<milliseconds>(elapsed).count());
    }
  }
  std::erase_if(threads_, [](const auto& thread) { return !thread.second.seen; });
  for (auto& [id, thread] : threads_) thread.seen = false;
  return spinning;
}

}  // namespace iotcloud::processes
