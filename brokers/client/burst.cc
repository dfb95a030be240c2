#include "iotcloud/brokers/client/burst.h"

namespace iotcloud::brokers::client {
namespace {

// A handler that takes longer is not quick: messages published before it would be held back for too long.
constexpr std::chrono::microseconds quick_time{100};
// Messages are held back for at most this time plus one quick handler.
constexpr std::chrono::microseconds longest{300};

}  // namespace

thread_local Burst* Burst::innermost = nullptr;

void Burst::Target::push() {
  const config::MutexLock lock(mutex_);
  if (push_) push_();
}

void Burst::Target::close() {
  const config::MutexLock lock(mutex_);
  push_ = nullptr;
}

Burst::~Burst() {
  innermost = outer_;
  for (const auto& target : targets_) target->push();
}

void Burst::before_handler(bool follows, bool quick) {
  holds_back_ = false;
  if (!began_) {
    if (!follows) return;
    began_ = last_ = clock_.now();
  } else if (last_ - *began_ > longest) {
    began_ = last_;
    return;  // messages published by this handler are not held back
  }
  holds_back_ = follows && quick;
}

std::optional<bool> Burst::after_handler() {
  if (!began_) return std::nullopt;
  const config::Clock::Instant before = std::exchange(last_, clock_.now());
  return last_ - before < quick_time;
}

}  // namespace iotcloud::brokers::client
