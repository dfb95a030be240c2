#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include <iotcloud/config/clock.h>

namespace iotcloud::gateway {

/// Limits how often something happens: it costs a token each time. A bucket has room for the tokens of a second, and is
/// full at first. Not thread safe.
class TokenBucket {
 public:
  /// Takes a token, if there is one. \param rate tokens that come in a second; at least one fits into the bucket
  bool take(config::Clock::Instant now, double rate) {
    const double most = std::max(1.0, rate);
    tokens_ = filled_ ? std::min(most, tokens_ + std::chrono::duration<double>(now - *filled_).count() * rate) : most;
    filled_ = now;
    if (tokens_ < 1) return false;
    tokens_ -= 1;
    return true;
  }

 private:
  double tokens_ = 0;
  std::optional<config::Clock::Instant> filled_;
};

}  // namespace iotcloud::gateway
