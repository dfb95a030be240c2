#include <iotcloud/topology/local/watched_files.h>

namespace iotcloud::local {

WatchedFiles::WatchedFiles(const std::vector<std::string>& paths) {
  for (const auto& path : paths) {
    const Stamp now = stamp(path);
    files_[path] = {now, now};
  }
}

std::string WatchedFiles::changed() {
  std::string found;
  for (auto& [path, file] : files_) {
    const Stamp now = stamp(path);
    if (now && now == std::exchange(file.at_last_look, now) && now != file.at_start) found = path;
  }
  return found;
}

WatchedFiles::Stamp WatchedFiles::stamp(const std::string& path) {
  std::error_code error;
  const auto written = std::filesystem::last_write_time(path, error);
  if (error) return std::nullopt;
  const auto size = std::filesystem::file_size(path, error);
  if (error) return std::nullopt;
  return std::pair(written, size);
}

}  // namespace iotcloud::local
