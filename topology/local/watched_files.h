#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace iotcloud::local {

/// Notices that one of some files was written anew. Used on one thread.
class WatchedFiles {
 public:
  explicit WatchedFiles(const std::vector<std::string>& paths);
  /// A file that is another one than at the start, and that nobody has written to since the last call, so that it is
  /// whole; empty: there is none. Call it about once a second.
  std::string changed();

 private:
  /// When it was written, and its bytes; nullopt: it is not there.
  using Stamp = std::optional<std::pair<std::filesystem::file_time_type, std::uintmax_t>>;
  struct File {
    Stamp at_start, at_last_look;
  };
  static Stamp stamp(const std::string& path);
  std::map<std::string, File> files_;
};

}  // namespace iotcloud::local
