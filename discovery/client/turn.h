#pragma once

#include <memory>
#include <mutex>

#include <iotcloud/config/thread_safety.h>

namespace iotcloud::discovery {

/// A mutex that is held while the dispatcher runs a callback of one directory or election, so that the object's
/// destructor waits for the callback. The dispatcher runs one callback at a time, so only destructors ever wait. The
/// mutex is recursive because a user's callback may destroy its own object.
class IOTCLOUD_CAPABILITY("turn") DispatchTurn {
 public:
  DispatchTurn() = default;
  DispatchTurn(const DispatchTurn&) = delete;
  DispatchTurn& operator=(const DispatchTurn&) = delete;

  void lock() IOTCLOUD_ACQUIRE() { mutex_.lock(); }
  void unlock() IOTCLOUD_RELEASE() { mutex_.unlock(); }
  /// For functions that such a callback calls, in which the thread safety analysis does not see that the turn is held.
  /// Does nothing at run time.
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(this) {}

 private:
  std::recursive_mutex mutex_;
};

/// Holds a turn to the end of the scope.
class IOTCLOUD_SCOPED_CAPABILITY DispatchTurnLock {
 public:
  explicit DispatchTurnLock(DispatchTurn& turn) IOTCLOUD_ACQUIRE(turn) : turn_(turn) { turn_.lock(); }
  ~DispatchTurnLock() IOTCLOUD_RELEASE() { turn_.unlock(); }
  DispatchTurnLock(const DispatchTurnLock&) = delete;
  DispatchTurnLock& operator=(const DispatchTurnLock&) = delete;

 private:
  DispatchTurn& turn_;
};

/// Base of an object whose callbacks the dispatcher runs, each with the object's turn. \tparam Self the class that
/// derives from it.
template <typename Self>
struct TakesTurns : std::enable_shared_from_this<Self> {
  /// Makes a callback that takes one argument and calls `function(self, argument)` with the turn held; it does nothing
  /// once `over` is set or the object is gone.
  template <typename Function>
  auto guarded(Function function) {
    return [weak = this->weak_from_this(), function](const auto& argument) {
      const auto self = weak.lock();
      if (!self) return;
      const DispatchTurnLock lock(self->turn);
      if (!self->over) function(*self, argument);
    };
  }

  DispatchTurn turn;
  bool over IOTCLOUD_GUARDED_BY(turn) = false;  ///< the object has ended
};

}  // namespace iotcloud::discovery
