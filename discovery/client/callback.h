#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include <iotcloud/discovery/client/serial_thread.h>

namespace iotcloud::discovery {

/// A user's callback behind a door that can be shut. It runs on the dispatcher; when states come faster than it runs,
/// each `report` replaces the one that still waits (`deliver_latest`), or all are delivered (`deliver_each`).
template <typename State>
class Callback : public std::enable_shared_from_this<Callback<State>> {
 public:
  using Function = std::function<void(const State&)>;
  explicit Callback(Function function) : function_(std::move(function)) {}

  void deliver_latest(SerialThread& dispatcher, State state) {
    {
      const std::lock_guard lock(mutex_);
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

  /// No call begins afterwards; one that runs on another thread is waited for.
  void shut() {
    std::unique_lock lock(mutex_);
    shut_ = true;
    if (running_ == std::this_thread::get_id()) return;
    left_.wait(lock, [this] { return running_ == std::thread::id(); });
  }

 private:
  void run(std::optional<State> state) {
    {
      const std::lock_guard lock(mutex_);
      if (shut_) return;
      if (!state) state = std::exchange(waiting_, std::nullopt);
      running_ = std::this_thread::get_id();
    }
    const auto leave = [this] {
      const std::lock_guard lock(mutex_);
      running_ = std::thread::id();
      left_.notify_all();
    };
    try {
      function_(*state);
    } catch (...) {
      leave();
      throw;  // to the dispatcher, which logs it
    }
    leave();
  }

  const Function function_;
  std::mutex mutex_;
  std::condition_variable left_;
  bool shut_ = false;             ///< guarded by mutex_
  std::thread::id running_;       ///< guarded by mutex_
  std::optional<State> waiting_;  ///< guarded by mutex_
};

}  // namespace iotcloud::discovery
