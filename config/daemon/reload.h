#pragma once

#include <exception>
#include <string>

#include <iotcloud/config/error.h>

namespace iotcloud::config {

/// The parts of a DaemonService::reload(), of which none that fails keeps another one from being done. Used on one
/// thread.
class Reload {
 public:
  template <typename Part>
  void part(Part&& read) {
    try {
      read();
    } catch (const std::exception& error) {
      problems_ += (problems_.empty() ? "" : "; ") + std::string(error.what());
    }
  }
  /// \throws Error with what all parts said that failed.
  void finish() const {
    if (!problems_.empty()) throw Error(problems_);
  }

 private:
  std::string problems_;
};

}  // namespace iotcloud::config
