#pragma once

#include <atomic>
#include <cstdint>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/scheduling/runnable.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>

namespace iotcloud::topology::internal {

class Scheduler;

/// A queue of tasks that are ready to run, first in, first out. An intrusive list: it allocates nothing. Not thread
/// safe.
class ReadyList {
 public:
  bool empty() const { return first_ == nullptr; }
  std::size_t size() const { return size_; }
  void push(Runnable& task);
  Runnable* pop();
  void append(ReadyList& other);         ///< leaves `other` empty
  std::int64_t worth_moving_ns() const;  ///< sum of the tasks' Runnable::worth_moving_ns()

 private:
  Runnable* first_ = nullptr;
  Runnable* last_ = nullptr;
  std::size_t size_ = 0;
};

/// A thread that runs tasks, and its run list. Each thread of the pool has its own lane; a thread that calls
/// Scheduler::run_now() borrows one. A derived class may hold more for the tasks (Scheduler::MakeLane).
class Lane {
 public:
  explicit Lane(Scheduler& scheduler) : scheduler_(scheduler) {}
  virtual ~Lane() = default;
  Lane(const Lane&) = delete;
  Lane& operator=(const Lane&) = delete;

  Scheduler& scheduler() { return scheduler_; }
  /// The task whose slice, open() or prepare() runs on this thread; OwnCall sets it.
  const Runnable* current = nullptr;
  /// real_ns() when it was last read: at the start of this slice or chunk. Reading the clock costs as much as a quick
  /// call of user code, so it is not read for each call.
  std::int64_t now_ns = 0;
  /// Reads the clock. \return nanoseconds since it was last read.
  std::uint64_t time_since_last_look() {
    const std::int64_t before = std::exchange(now_ns, real_ns());
    return static_cast<std::uint64_t>(now_ns - before);
  }

  // The run list, first in, first out; but a source that is ready waits until the others have done their work, for
  // `longest_wait_ns` at most. Otherwise it would fill their queues, and tuples would grow cold there.
  // Scheduler::offload_stuck_threads() empties it from another thread when this one stays in user code for long.
  void push(Runnable& task);
  Runnable* pop();
  void take_all(ReadyList& into);
  /// \name For a thread of the pool, whose lane other threads may give tasks to while it is awake.
  /// @{
  void wake();
  /// Any thread. \param now real_ns() as the calling thread read it last. \return false, and does nothing, when the
  /// lane is not awake.
  bool push_if_awake(Runnable& task, std::int64_t now);
  Runnable* pop_or_sleep();     ///< as pop(); when there is none, the lane is not awake any more
  void sleep(ReadyList& into);  ///< as take_all(), and the lane is not awake any more
  /// @}
  std::size_t ready_count() const { return ready_count_.load(std::memory_order_relaxed); }
  std::int64_t worth_moving_ns();  ///< sum of the tasks' Runnable::worth_moving_ns()
  /// A task that runs before those of the run list; null: none. It was put here when the running slice was about to
  /// end, so it does not wait, and no other thread needs to see it. Topologies have no cycles, so the run list has its
  /// turn.
  Runnable* next = nullptr;
  /// Whether the running slice must end soon, because other tasks are ready on this lane.
  bool has_ready() const { return next != nullptr || ready_count() > 0; }
  // For Scheduler::offload_stuck_threads() and report_hanging(), which run on the timers' thread.
  std::atomic<std::int64_t> slice_began_ns{0};    ///< real_ns() when the running slice began; 0: no slice runs
  std::atomic<Runnable*> running{nullptr};        ///< the task whose slice runs
  std::atomic<std::int64_t> reported_hang_ns{0};  ///< slice_began_ns of the last slice that was reported as hanging

  /// The lane of the calling thread; nullptr when it is in no task's call.
  static Lane* of_this_thread();

 private:
  void push_locked(Runnable& task, std::int64_t since_ns) IOTCLOUD_REQUIRES(mutex_);
  Runnable* pop_locked() IOTCLOUD_REQUIRES(mutex_);
  void take_all_locked(ReadyList& into) IOTCLOUD_REQUIRES(mutex_);

  Scheduler& scheduler_;
  std::atomic<std::size_t> ready_count_{0};
  config::Mutex mutex_;
  static constexpr std::int64_t longest_wait_ns = 1'000'000;
  bool awake_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  ReadyList ready_ IOTCLOUD_GUARDED_BY(mutex_);
  ReadyList sources_ IOTCLOUD_GUARDED_BY(mutex_);
  std::int64_t sources_since_ns_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< since when the first of them waits
};

// initial-exec: the compiler reads the variable without a function call. That is allowed because the runtime is linked
// into programs and never loaded with dlopen().
extern thread_local constinit Lane* lane_of_this_thread __attribute__((tls_model("initial-exec")));

inline Lane* Lane::of_this_thread() {
  return lane_of_this_thread;
}

/// Marks, while it lives, that the calling thread runs user code of the task; emits are allowed only then.
class OwnCall {
 public:
  OwnCall(Lane& lane, const Runnable& task) : lane_(lane), outer_lane_(lane_of_this_thread), outer_(lane.current) {
    lane_of_this_thread = &lane;
    lane.current = &task;
  }
  ~OwnCall() {
    lane_.current = outer_;
    lane_of_this_thread = outer_lane_;
  }
  OwnCall(const OwnCall&) = delete;
  OwnCall& operator=(const OwnCall&) = delete;

  static bool is_of(const Runnable& task) {
    return lane_of_this_thread != nullptr && lane_of_this_thread->current == &task;
  }

 private:
  Lane& lane_;
  Lane* outer_lane_;
  const Runnable* outer_;
};

}  // namespace iotcloud::topology::internal
