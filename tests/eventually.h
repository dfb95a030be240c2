#pragma once

#include <chrono>
#include <functional>
#include <thread>

namespace iotcloud::tests {

/// Waits for what only asking tells: asks once a millisecond, so that the locks which the condition takes are free for
/// others. \return false when `limit` passed first; only a test that fails uses it up.
[[nodiscard]] inline bool eventually(const std::function<bool()>& condition,
                                     std::chrono::milliseconds limit = std::chrono::seconds(60)) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace iotcloud::tests
