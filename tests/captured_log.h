#pragma once

#include <cstdio>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>

#include <unistd.h>

#include "iotcloud/tests/files.h"

namespace iotcloud::tests {

/// Keeps what the process logs, from construction to destruction, in a file that can be read meanwhile: nothing is lost
/// between two looks. At its end the log goes to stderr after all. One at a time.
class CapturedLog {
 public:
  CapturedLog() : path_(std::filesystem::temp_directory_path() / ("captured-log-" + std::to_string(::getpid()))) {
    std::fflush(stderr);
    stderr_ = ::dup(STDERR_FILENO);
    if (stderr_ < 0 || std::freopen(path_.c_str(), "w", stderr) == nullptr) {
      throw std::runtime_error("cannot write the log to " + path_.string());
    }
  }
  ~CapturedLog() {
    std::fflush(stderr);
    ::dup2(stderr_, STDERR_FILENO);
    ::close(stderr_);
    std::fputs(text().c_str(), stderr);
    std::filesystem::remove(path_);
  }
  CapturedLog(const CapturedLog&) = delete;
  CapturedLog& operator=(const CapturedLog&) = delete;

  std::string text() const { return read_file(path_); }
  bool contains(std::string_view words) const { return text().find(words) != std::string::npos; }

 private:
  std::filesystem::path path_;
  int stderr_ = -1;
};

}  // namespace iotcloud::tests
