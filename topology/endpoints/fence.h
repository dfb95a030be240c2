#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>

#include <iotcloud/config/clock.h>

namespace iotcloud::topology {

/// Between a worker that lost its place without noticing and the devices. A broker cuts off a process that stands still
/// (SIGSTOP, a paused machine), gives what it had in hand to the next reader, and tells it nothing; when it goes on, it
/// has commands in hand that another worker has sent long ago.
///
/// So whoever is about to hand a message on asks whether the process has stood still for longer than `limit` since its
/// last beat. If so the fence is put up: what was taken from a broker before is void, as the broker gives it to whoever
/// reads now; all channels are subscribed to anew, which confirms the places. Thread safe.
class Fence {
 public:
  using Instant = config::Clock::Instant;

  /// One that is put up by put_up() only.
  Fence() = default;
  /// \param limit how long the process may stand still before a broker can have cut it off. \param clock outlives this.
  Fence(const config::Clock& clock, std::chrono::milliseconds limit);

  /// The process runs. Called well within `limit`; tells the listeners when the fence was put up meanwhile.
  void beat();
  /// Everything taken until now is void. The listeners are told with the next beat().
  void put_up();
  /// What was taken before is void.
  Instant since() const;
  bool voids(Instant taken) const { return taken < since(); }
  /// How often the fence was put up.
  std::uint64_t count() const;

  /// Calls back after the fence was put up, from the thread of beat(). \return a number for ignore()
  int listen(std::function<void()> on_put_up);
  /// Returns when that callback does not run any more.
  void ignore(int listener);

 private:
  Instant now() const;
  void check(Instant now) const;
  void raise() const;

  const config::Clock* const clock_ = nullptr;
  const std::int64_t limit_ns_ = 0;  ///< 0: none
  mutable std::atomic<std::int64_t> last_beat_ns_{0};
  mutable std::atomic<std::int64_t> since_ns_{INT64_MIN};
  mutable std::atomic<std::uint64_t> count_{0};

  std::mutex mutex_;
  std::uint64_t told_ = 0;                          ///< guarded by mutex_
  int last_listener_ = 0;                           ///< guarded by mutex_
  std::map<int, std::function<void()>> listeners_;  ///< guarded by mutex_
};

}  // namespace iotcloud::topology
