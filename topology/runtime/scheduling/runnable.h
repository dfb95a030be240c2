#pragma once

#include <atomic>
#include <cstdint>

namespace iotcloud::topology::internal {

class Executors;
class Lane;

/// A unit of work for a scheduler; the runtime's tasks derive from it. It works in slices, which never overlap, each on
/// the thread whose run list it is on. It must outlive its scheduler's threads.
class Runnable {
 public:
  /// Whether it brings work to others, or does what it is given.
  enum class Role : bool { worker, source };
  /// \param executors the runnable holds one of these while it runs a slice; must outlive the runnable. \param home
  /// which thread of the pool gets it when there is much to do (Scheduler), counted round the pool's threads;
  /// `anywhere`: none.
  Runnable(Executors& executors, Role role, int home = anywhere) : executors_(executors), role_(role), home_(home) {}
  virtual ~Runnable() = default;
  static constexpr int anywhere = -1;
  Runnable(const Runnable&) = delete;
  Runnable& operator=(const Runnable&) = delete;

  /// Works for a while on the calling thread. \return true when there is more to do.
  virtual bool slice(Lane& lane) = 0;
  /// Estimates how long its present work will take, as far as it pays to do it on another core. Any thread.
  virtual std::int64_t worth_moving_ns() const = 0;
  /// A timer is due; `bits` were given to Timers::add(). Any thread; must not call Timers, whose lock is held.
  virtual void signal(std::uint32_t bits) = 0;
  /// Called on the timers' thread when a slice has been running for `for_ns` and may hang.
  virtual void hangs(std::int64_t for_ns) = 0;

 private:
  friend class Lane;
  friend class ReadyList;
  friend class Scheduler;
  enum class State : std::uint8_t {
    idle,      ///< nothing to do
    queued,    ///< on one run list
    running,   ///< a thread runs its slice; also the state before Scheduler::release()
    notified,  ///< running, and schedule() was called since the slice began
  };
  std::atomic<State> state_{State::running};
  Runnable* next_ready_ = nullptr;  ///< the next one on the same ReadyList
  Executors& executors_;
  const Role role_;
  const int home_;
};

}  // namespace iotcloud::topology::internal
