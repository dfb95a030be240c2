#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/serial_thread.h>

namespace iotcloud::discovery {

/// A user's callback that can be shut off. The dispatcher runs it. If states come faster than it runs, deliver_latest()
/// replaces the waiting state, deliver_each() delivers them all.
template <typename State>
class Callback : public std::enable_shared_from_this<Callback<State>> {
 public:
  using Function = std::function<void(const State&)>;
  explicit Callback(Function function) : function_(std::move(function)) {}

  void deliver_latest(SerialThread& dispatcher, State state) {
    {
      const config::MutexLock lock(mutex_);
      if (shut_ || !function_) return;
      const bool waits = waiting_.has_value();
      waiting_ = std::move(state);
      if (waits) return;
    }
    dispatcher.post([self = this->shared_from_this()] { self->run(std::nullopt); });
  }

  void deliver_each(SerialThread& dispatcher, State state) {
    if (!function_) return;
    dispatcher.post([self = this->shared_from_this(), state = std::move(state)] { self->run(state); });
  }

  /// No call of the callback begins after this. If another thread runs the callback now, shut() waits for the end of
  /// that call.
  void shut() {
    const config::MutexLock lock(mutex_);
    shut_ = true;
    if (running_ == std::this_thread::get_id()) return;
    left_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return running_ == std::thread::id(); });
  }

 private:
  void run(std::optional<State> state) {
    {
      const config::MutexLock lock(mutex_);
      if (shut_) return;
      if (!state) state = std::exchange(waiting_, std::nullopt);
      running_ = std::this_thread::get_id();
    }
    const auto leave = [this] {
      const config::MutexLock lock(mutex_);
      running_ = std::thread::id();
      left_.notify_all();
    };
    try {
      function_(*state);
    } catch (...) {
      leave();
      throw;  // the dispatcher logs it
    }
    leave();
  }

  const Function function_;
  config::Mutex mutex_;
  config::ConditionVariable left_;
  bool shut_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread::id running_ IOTCLOUD_GUARDED_BY(mutex_);
  std::optional<State> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::discovery
