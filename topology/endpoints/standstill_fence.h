#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <thread>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::topology {

/// Keeps a worker from sending stale commands to devices. A broker closes the connection of a process that stands still
/// (SIGSTOP, a paused machine) and delivers the process's unsettled messages to the next reader. The process does not
/// notice: when it goes on, it holds commands that another worker sent long ago.
///
/// So an endpoint asks this object before it passes a message on. If the process has stood still for longer than
/// `limit` since the last beat(), the fence is raised: messages that were taken from a broker before are void, because
/// the broker has delivered them to another reader, and the listeners subscribe to all channels anew. Thread safe.
class StandstillFence {
 public:
  using Instant = config::Clock::Instant;

  /// A fence that only raise() raises.
  StandstillFence() = default;
  /// \param clock must outlive the fence. \param limit how long the process may stand still before a broker can have
  /// closed its connections.
  StandstillFence(const config::Clock& clock, std::chrono::milliseconds limit);

  /// Says that the process runs; its owner calls it much more often than once in `limit`. Calls the listeners if the
  /// fence was raised since the last call.
  void beat() IOTCLOUD_EXCLUDES(mutex_);
  /// Raises the fence: everything taken until now is void. The next beat() calls the listeners.
  void raise();
  /// When the fence was raised last. Messages that were taken before are void.
  Instant since() const;
  /// Whether a message that was taken at this time is void.
  bool voids(Instant taken) const { return taken < since(); }
  /// How often the fence was raised. Messages that were taken while the count was lower are void.
  std::uint64_t count() const;

  /// Adds a listener, which beat() calls on its thread after the fence was raised. No lock is held: the listener may
  /// call the fence. \return a number for ignore()
  int listen(std::function<void()> on_raised) IOTCLOUD_EXCLUDES(mutex_);
  /// Removes a listener; waits until it does not run any more, unless a listener calls this.
  void ignore(int listener) IOTCLOUD_EXCLUDES(mutex_);

 private:
  Instant now() const;
  void check(Instant now) const;
  void void_all() const;
  void tell_listeners() IOTCLOUD_REQUIRES(mutex_);
  void call(int listener) IOTCLOUD_REQUIRES(mutex_);

  const config::Clock* const clock_ = nullptr;
  const std::int64_t limit_ns_ = 0;  ///< 0: a standstill is not looked for
  mutable std::atomic<std::int64_t> last_beat_ns_{0};
  mutable std::atomic<std::int64_t> since_ns_{INT64_MIN};
  mutable std::atomic<std::uint64_t> count_{0};

  config::Mutex mutex_;
  config::ConditionVariable left_;  ///< signals that a listener has returned
  /// The thread that calls the listeners; none: no thread does.
  std::thread::id teller_ IOTCLOUD_GUARDED_BY(mutex_);
  int called_ IOTCLOUD_GUARDED_BY(mutex_) = 0;          ///< the number of the listener that runs; 0: none
  std::uint64_t told_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< count_ when the listeners were called last
  int last_listener_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::map<int, std::function<void()>> listeners_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Beats for a fence, on a thread of its own, until it is destroyed.
class FenceHeart {
 public:
  /// \param fence lives as long. \param limit the fence's
  FenceHeart(StandstillFence& fence, std::chrono::milliseconds limit);

 private:
  std::jthread thread_;
};

}  // namespace iotcloud::topology
