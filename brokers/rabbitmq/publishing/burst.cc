#include "iotcloud/brokers/rabbitmq/publishing/burst.h"

#include "iotcloud/brokers/rabbitmq/publishing/publish_link.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

// A handler that takes longer is not quick: what was published before it would wait for too long.
constexpr std::chrono::microseconds quick_time{100};
// So long messages are held back, and for one quick handler more.
constexpr std::chrono::microseconds longest{300};

}  // namespace

thread_local Burst* Burst::innermost = nullptr;

void Reachable::gone() {
  const std::lock_guard lock(mutex_);
  link_ = nullptr;
}

void Reachable::push() {
  const std::lock_guard lock(mutex_);
  if (link_ != nullptr) link_->push();
}

Burst::~Burst() {
  innermost = outer_;
  for (const auto& link : links_) link->push();
}

void Burst::before_handler(bool follows, bool quick) {
  holds_back_ = false;
  if (!began_) {
    if (!follows) return;
    began_ = last_ = clock_.now();
  } else if (last_ - *began_ > longest) {
    began_ = last_;
    return;  // this one sends all
  }
  holds_back_ = follows && quick;
}

std::optional<bool> Burst::after_handler() {
  if (!began_) return std::nullopt;
  const config::Clock::Instant before = std::exchange(last_, clock_.now());
  return last_ - before < quick_time;
}

}  // namespace iotcloud::brokers::rabbitmq
