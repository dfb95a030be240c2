#pragma once

#include <algorithm>
#include <chrono>
#include <random>

namespace iotcloud::brokers::client {

/// Waiting times that double up to a limit, each shortened at random by up to a half, so that the clients of a
/// restarted server do not all come back at once. Not thread safe.
class Backoff {
 public:
  Backoff(std::chrono::milliseconds first, std::chrono::milliseconds limit) : first_(first), limit_(limit) {}

  std::chrono::milliseconds next() {
    current_ = current_.count() == 0 ? first_ : std::min(limit_, current_ * 2);
    thread_local std::minstd_rand random{std::random_device{}()};
    std::uniform_int_distribution<std::int64_t> spread(current_.count() / 2, current_.count());
    return std::chrono::milliseconds(spread(random));
  }
  void reset() { current_ = std::chrono::milliseconds(0); }

 private:
  std::chrono::milliseconds first_;
  std::chrono::milliseconds limit_;
  std::chrono::milliseconds current_{0};
};

}  // namespace iotcloud::brokers::client
