#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>

#include "iotcloud/config/clock.h"

namespace iotcloud::fuzz {

/// A clock that stands still while one input is processed.
class InputClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 1; }
  void move(std::chrono::milliseconds by) { now_ = now_.load() + by; }

 private:
  std::atomic<Instant> now_{Instant(std::chrono::hours{1})};
};

/// Reports at the end how many uploads were complete.
struct Tally {
  ~Tally() { std::fprintf(stderr, "plugins that came whole: %d\n", whole.load()); }
  std::atomic<int> whole = 0;
};

}  // namespace iotcloud::fuzz
