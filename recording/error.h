#pragma once

#include <stdexcept>

namespace iotcloud::recording {

/// A recording that cannot be written or read. what() names the file, the place in it, and how to mend it.
class RecordingError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace iotcloud::recording
