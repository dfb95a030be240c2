#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace iotcloud::check {

/// Takes secrets out of texts: what it was told, and what looks like one wherever it stands - passwords in URLs,
/// tokens, values of keys that are called so (as `iotcloud drivers` hides them), private keys. Not thread safe.
class Redactor {
 public:
  /// This text is a secret; wherever it stands, `***` comes instead. Of less than 4 characters it is ignored: it would
  /// be everywhere.
  void add_secret(std::string secret);
  /// The first line, and all lines, of a file that holds a secret. A file that cannot be read holds none that could be
  /// in the bundle.
  void add_secret_file(const std::string& file);
  std::string redacted(std::string text) const;

 private:
  std::vector<std::string> secrets_;  ///< the longest first
};

/// Files by name, as one archive (tar, gzip). \param time_s when it was made, Unix time
std::string archive_of(const std::map<std::string, std::string>& files, std::int64_t time_s);

}  // namespace iotcloud::check
