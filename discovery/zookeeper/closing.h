#pragma once

#include <chrono>
#include <functional>

namespace iotcloud::discovery::zookeeper {

/// Runs `close` on a thread of its own and waits for its end, at most for `patience`. When the process exits, it waits
/// a few seconds for calls of `close` that still run. Thread safe.
void close_elsewhere(std::function<void()> close, std::chrono::milliseconds patience);

}  // namespace iotcloud::discovery::zookeeper
