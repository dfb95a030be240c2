#pragma once

#include <chrono>
#include <functional>
#include <thread>

namespace iotcloud::tests {

/// How long a test waits for something that must happen. Long enough for a very busy machine: only a failing test waits
/// for all of it.
inline constexpr std::chrono::seconds patience{120};

/// Waits for a condition by asking once a millisecond, so that the locks which the condition takes are free for others.
/// \return false if `limit` passed first.
[[nodiscard]] inline bool eventually(const std::function<bool()>& condition,
                                     std::chrono::milliseconds limit = patience) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace iotcloud::tests
