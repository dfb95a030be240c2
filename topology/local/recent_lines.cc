#include <algorithm>
#include <charconv>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <deque>
#include <string_view>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/local/recent_lines.h>

namespace iotcloud::local {

namespace {

struct Kept {
  config::Mutex mutex;
  std::deque<std::string> lines IOTCLOUD_GUARDED_BY(mutex);
  std::size_t bytes IOTCLOUD_GUARDED_BY(mutex) = 0;    ///< of `lines`
  std::uint64_t first IOTCLOUD_GUARDED_BY(mutex) = 0;  ///< number of the first of them
  int keepers IOTCLOUD_GUARDED_BY(mutex) = 0;          ///< RecentLines objects
};

Kept& kept() {
  static Kept& lines = *new Kept;  // never destroyed: threads may still log while the process ends
  return lines;
}

const char* word_of(config::LogLevel level) {
  switch (level) {
    case config::LogLevel::debug:
      return "debug";
    case config::LogLevel::info:
      return "info";
    case config::LogLevel::warn:
      return "warning";
    case config::LogLevel::error:
    case config::LogLevel::off:
      break;
  }
  return "error";
}

void take(config::LogLevel level, std::string_view part, std::string_view text) noexcept try {
  const std::int64_t now_ms = config::system_clock().wall_ms();
  std::string line = fmt::format("{:%FT%T}.{:03}Z {} {}: {}\n", fmt::gmtime(static_cast<std::time_t>(now_ms / 1000)),
                                 now_ms % 1000, word_of(level), part, text);
  std::fwrite(line.data(), 1, line.size(), stderr);
  Kept& all = kept();
  const config::MutexLock lock(all.mutex);
  all.bytes += line.size();
  all.lines.push_back(std::move(line));
  while (all.bytes > RecentLines::most_bytes && all.lines.size() > 1) {
    all.bytes -= all.lines.front().size();
    all.lines.pop_front();
    ++all.first;
  }
} catch (...) {  // a line that cannot be written must not stop who logs it
}

}  // namespace

RecentLines::RecentLines() {
  Kept& all = kept();
  const config::MutexLock lock(all.mutex);
  if (all.keepers++ == 0) config::set_log_target(take);
}

RecentLines::~RecentLines() {
  Kept& all = kept();
  const config::MutexLock lock(all.mutex);
  if (--all.keepers == 0) config::set_log_target(nullptr);
}

RecentLines::Part RecentLines::read(const std::string& position, std::size_t most) {
  std::uint64_t from = 0;
  const auto [end, problem] = std::from_chars(position.data(), position.data() + position.size(), from);
  if (!position.empty() && (problem != std::errc() || end != position.data() + position.size()))
    throw config::Error("\"" + position.substr(0, 40) + "\" is no position in the log");
  Kept& all = kept();
  const config::MutexLock lock(all.mutex);
  const std::uint64_t after = all.first + all.lines.size();
  std::size_t place = 0;
  if (position.empty()) {
    std::size_t bytes = 0;
    for (place = all.lines.size(); place > 0 && bytes + all.lines[place - 1].size() <= most; --place)
      bytes += all.lines[place - 1].size();
  } else if (from > all.first) {
    place = static_cast<std::size_t>(std::min(from, after) - all.first);
  }
  Part part;
  for (; place < all.lines.size() && (part.text.empty() || part.text.size() + all.lines[place].size() <= most); ++place)
    part.text += all.lines[place];
  part.position = std::to_string(all.first + place);
  return part;
}

}  // namespace iotcloud::local
