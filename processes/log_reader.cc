#include <charconv>
#include <cstdint>
#include <optional>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/log_reader.h>

namespace iotcloud::processes {

namespace {

struct PlaceInLog {
  std::uint64_t file = 0;  ///< the file's inode, which a rename does not change
  std::uint64_t offset = 0;
};

struct OpenLog {
  OwnedDescriptor descriptor;
  std::uint64_t file = 0;
  std::uint64_t size = 0;
};

std::string to_string(const PlaceInLog& place) {
  return fmt::format("{}:{}", place.file, place.offset);
}

PlaceInLog parse(const std::string& position) {
  PlaceInLog place;
  const char* const end = position.data() + position.size();
  const auto file = std::from_chars(position.data(), end, place.file);
  if (file.ec == std::errc{} && file.ptr != end && *file.ptr == ':') {
    const auto offset = std::from_chars(file.ptr + 1, end, place.offset);
    if (offset.ec == std::errc{} && offset.ptr == end) return place;
  }
  throw config::Error(fmt::format("\"{}\" is no position in a log; give one that came with an earlier part", position));
}

std::optional<OpenLog> open_log(const std::string& path) {
  // Who writes logs may put something else in their place, which is not shown.
  OpenLog log{OwnedDescriptor(open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC)), 0, 0};
  struct stat status {};
  if (!log.descriptor || fstat(log.descriptor.get(), &status) != 0 || !S_ISREG(status.st_mode)) return std::nullopt;
  log.file = status.st_ino;
  log.size = static_cast<std::uint64_t>(status.st_size);
  return log;
}

/// Opens the log and its older files, the oldest first.
std::vector<OpenLog> all_logs(const std::string& path) {
  std::vector<OpenLog> logs;
  auto newest = open_log(path);
  for (int number = 1; auto older = open_log(fmt::format("{}.{}", path, number)); ++number) {
    // A file that was rotated meanwhile must not be listed twice.
    if (!newest || older->file != newest->file) logs.insert(logs.begin(), std::move(*older));
  }
  if (newest) logs.push_back(std::move(*newest));
  return logs;
}

std::string read_at(const OpenLog& log, std::uint64_t offset, std::size_t most) {
  std::string text(most, '\0');
  const ssize_t count = pread(log.descriptor.get(), text.data(), most, static_cast<off_t>(offset));
  text.resize(count > 0 ? static_cast<std::size_t>(count) : 0);
  return text;
}

LogExcerpt read_end(const OpenLog& log, std::size_t most) {
  const std::uint64_t from = log.size > most ? log.size - most : 0;
  std::string text = read_at(log, from, most);
  const PlaceInLog next{log.file, from + text.size()};
  if (from > 0) {
    if (const auto line = text.find('\n'); line != std::string::npos) text.erase(0, line + 1);
  }
  return {std::move(text), to_string(next)};
}

}  // namespace

LogExcerpt read_log(const std::string& path, const std::string& position, std::size_t most) {
  const auto logs = all_logs(path);
  if (logs.empty()) throw config::Error(fmt::format("there is no log {} yet", path));
  if (position.empty()) return read_end(logs.back(), most);
  PlaceInLog place = parse(position);
  std::size_t at = 0;
  while (at < logs.size() && logs[at].file != place.file) ++at;
  if (at == logs.size()) {
    at = 0;
    place = {logs[0].file, 0};
  }
  std::string text = read_at(logs[at], place.offset, most);
  while (text.empty() && at + 1 < logs.size()) {
    ++at;
    place = {logs[at].file, 0};
    text = read_at(logs[at], 0, most);
  }
  // An incomplete last line is left for the next call.
  if (const auto last = text.rfind('\n'); last != std::string::npos) {
    text.resize(last + 1);
  } else if (text.size() < most) {
    text.clear();
  }
  place.offset += text.size();
  return {std::move(text), to_string(place)};
}

}  // namespace iotcloud::processes
