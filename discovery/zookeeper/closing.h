#pragma once

#include <chrono>
#include <functional>

namespace iotcloud::discovery::zookeeper {

/// Runs `close` on a thread of its own and waits for its end, but no longer than `patience`. What still closes when the
/// process ends is waited for then, for a few seconds. Thread safe.
void close_elsewhere(std::function<void()> close, std::chrono::milliseconds patience);

}  // namespace iotcloud::discovery::zookeeper
