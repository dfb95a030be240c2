#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/burst.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

/// Collects the messages that one thread publishes while it handles records that came together, so that they go to the
/// library together, as one request. Given one by one they would become as many requests, because the library sends
/// each as soon as it can. (A client::Burst holds bytes back in the socket, for microseconds and only between quick
/// handlers; here the messages themselves wait until all records are handled.)
///
/// Lives on the stack of that thread, which alone calls its functions.
class Gathering {
 public:
  using Instant = config::Clock::Instant;
  /// A producer that keeps messages back. Thread safe.
  using Target = client::Burst::Target;

  Gathering() : outer_(std::exchange(current_, this)) {}
  ~Gathering() { current_ = outer_; }
  Gathering(const Gathering&) = delete;
  Gathering& operator=(const Gathering&) = delete;

  /// The calling thread's gathering; null if it has none.
  static Gathering* of_this_thread() { return current_; }
  /// Whether more records wait behind the one that is handled now.
  void more_follow(bool more) { more_follow_ = more; }
  bool more_follow() const { return more_follow_; }
  void add(const std::shared_ptr<Target>& target, Instant now) {
    if (targets_.empty()) began_ = now;
    if (targets_.empty() || targets_.back() != target) targets_.push_back(target);
  }
  bool empty() const { return targets_.empty(); }
  /// When the first message was kept back. Requires !empty().
  Instant began() const { return began_; }
  /// Makes the targets send all messages that were kept back; then a new gathering begins.
  void end() {
    for (const auto& target : std::exchange(targets_, {})) target->push();
  }

 private:
  inline static thread_local Gathering* current_ = nullptr;
  Gathering* const outer_;
  bool more_follow_ = false;
  Instant began_{};
  std::vector<std::shared_ptr<Target>> targets_;
};

}  // namespace iotcloud::brokers::kafka
