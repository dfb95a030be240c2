#pragma once

#include <cstdlib>

namespace iotcloud::tests {

/// True in `./dev test --long`, where a test may take minutes (iotcloud_test(LONG)).
inline bool long_run() {
  return std::getenv("IOTCLOUD_LONG") != nullptr;
}

}  // namespace iotcloud::tests
