#pragma once

#include <string>
#include <string_view>

/// Files that are complete or not there, also after a loss of power. All functions wait for the disk, and throw
/// config::Error with the path and the reason.
namespace iotcloud::config {

/// Makes a file with these permissions. Fails if it exists already, and leaves none behind when it fails.
void write_new_file(const std::string& file, std::string_view text, unsigned permissions);

/// A file's next text, which stands in a new file beside the old one until replace() puts it in the old one's place.
/// The destructor removes the new file if replace() was not called. A new file that a killed process left is removed by
/// the next object for the same file. Not thread safe; one for each file and process.
class Replacement {
 public:
  Replacement(std::string file, std::string_view text, unsigned permissions);
  ~Replacement();
  Replacement(const Replacement&) = delete;
  Replacement& operator=(const Replacement&) = delete;

  /// The path of the new file, to give it another owner.
  const std::string& path() const { return fresh_; }
  /// Whoever opens the file finds the old text until then, and the new one from then on.
  void replace();

 private:
  const std::string file_;
  const std::string fresh_;
  bool replaced_ = false;
};

/// Replaces a file, or makes it, with these permissions.
void replace_file(const std::string& file, std::string_view text, unsigned permissions);

/// Waits until the folder's entries (new, renamed and removed files) are on the disk.
void sync_folder(const std::string& folder);

}  // namespace iotcloud::config
