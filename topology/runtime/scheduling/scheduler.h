#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/scheduling/executors.h>
#include <iotcloud/topology/runtime/scheduling/lane.h>
#include <iotcloud/topology/runtime/scheduling/runnable.h>

namespace iotcloud::topology::internal {

class Timers;

/// Decides which thread runs which task. A task that becomes ready on a thread that runs tasks goes to the end of that
/// thread's own run list, and no other thread is woken. Tasks move from a run list to the pool in three cases: a thread
/// that called run_now() has worked for `caller_slice`; a pool thread has much work while another one sleeps; or a
/// thread stays in one task for `long_slice` (offload_stuck_threads()). While several threads of the pool are awake, a
/// task with a home that has got much to do goes to the thread that is its home: otherwise each thread would take each
/// task in turn, and what a task keeps would go from core to core.
class Scheduler {
 public:
  /// Makes a Lane, or an object of a derived class that the tasks know. Called on any thread.
  using MakeLane = std::function<std::unique_ptr<Lane>(Scheduler&)>;
  /// \param threads of the pool; 0: none. \param timers must outlive the scheduler.
  Scheduler(unsigned threads, std::chrono::microseconds caller_slice, std::chrono::microseconds long_slice,
            MakeLane make_lane, Timers& timers);
  ~Scheduler();

  void start();
  /// Makes sure that no thread starts a slice any more. Does not wait for the running ones.
  void halt();
  /// Waits until the running slices have ended. \return false when `deadline` passed first. \pre halt() was called.
  bool wait_halted(std::chrono::steady_clock::time_point deadline);
  /// Joins the pool; waits as long as user code runs. \pre halt() was called.
  void join();
  /// Whether some thread runs a slice of the task. After halt() the answer only changes from true to false.
  bool runs(const Runnable& task) const;

  /// Makes sure that the task runs a slice that begins after this call. Any thread. \param much it has got much to do.
  void schedule(Runnable& task, bool much = false) noexcept;
  /// As schedule(), but if the task is idle, the calling thread runs it and the tasks that it makes ready.
  void run_now(Runnable& task) noexcept;
  /// Takes the task if it is idle: until run_taken(), no other thread can run it, and the caller alone may prepare its
  /// slice. \return false when it was not idle. Any thread.
  bool take(Runnable& task) noexcept;
  /// Lets a task run that take() has taken. \param next in a slice that is about to end: before the tasks that are
  /// ready on this thread. \param much it has got much to do.
  void run_taken(Runnable& task, bool next, bool much) noexcept;
  /// Allows the task to run. A new task does not run before this call; it runs now if schedule() was called for it
  /// already, or if `ready`.
  void release(Runnable& task, bool ready);
  /// Runs the tasks that wait for the pool on the calling thread, and all that become ready, until none is left.
  void run_until_idle();

  bool idle() const { return busy_.load() == 0; }
  /// Waits until no task has work and `condition` holds. \return false when `deadline` passed first.
  bool wait_idle(std::chrono::steady_clock::time_point deadline, const std::function<bool()>& condition);

  /// A run list is given away when its tasks' Runnable::worth_moving_ns() are this much, or when they are many. Waking
  /// a thread costs about as much.
  static constexpr std::int64_t worth_sharing_ns = 50'000;
  /// Moves the run lists of threads that have been in one task for `long_slice` to the pool.
  /// \return true when other run lists have tasks, so that it should be called again in a millisecond.
  bool offload_stuck_threads();

  /// Calls Runnable::hangs() for each task whose slice has been running for `limit`, once for each slice.
  void report_hanging(std::chrono::milliseconds limit);
  /// The slice that has been running for longest now.
  struct LongSlice {
    const Runnable* task = nullptr;  ///< nullptr: none runs
    std::int64_t for_ns = 0;
  };
  LongSlice longest_slice() const;
  /// Changes the limit of `executors`, and hands the tasks that may run now to the pool.
  void set_limit(Executors& executors, int limit);

  /// The lane for user code that is called outside of slices (open, prepare).
  Lane& spare_lane() { return *spare_lane_; }

 private:
  using State = Runnable::State;
  /// Which thread runs a lane: one of the pool, one that called run_now(), or the only one, because there is no pool.
  enum class Kind { pool, caller, only };
  /// \param first runs first; it is queued, and on no run list.
  void run(Lane& lane, Kind kind, Runnable& first) noexcept;
  static Runnable* next_of(Lane& lane, Kind kind) noexcept;
  bool runs_on_this_thread(Lane* lane) const;
  void run_slice(Lane& lane, Runnable& task) noexcept;
  /// \return true when the task was idle: the caller must put it on a run list.
  bool make_ready(Runnable& task) noexcept;
  bool send_home(const Lane& from, Runnable& task) noexcept;
  void now_idle() noexcept;
  void hand_over(ReadyList& tasks) noexcept;
  void hand_over(Runnable& task) noexcept;
  bool share(Lane& lane, Kind kind, std::int64_t busy_ns) noexcept;
  void pool_thread(Lane& lane);
  Lane* borrow_lane();
  void return_lane(Lane* lane);

  const unsigned threads_;
  const std::int64_t caller_slice_ns_, long_slice_ns_;
  const MakeLane make_lane_;
  Timers& timers_;
  std::atomic<bool> halted_{false};
  std::atomic<std::int64_t> busy_{0};         ///< number of tasks that are not idle
  std::atomic<bool> waited_for_{false};       ///< wait_idle() or wait_halted() was called: notify changed_
  std::atomic<std::size_t> shared_count_{0};  ///< size of shared_, to be read without the lock
  std::atomic<unsigned> sleeping_{0};         ///< number of pool threads that wait for work

  mutable config::Mutex mutex_;
  config::ConditionVariable work_;                                        ///< the pool waits here
  config::ConditionVariable changed_;                                     ///< wait_idle and wait_halted wait here
  ReadyList shared_ IOTCLOUD_GUARDED_BY(mutex_);                          ///< tasks that wait for a thread of the pool
  std::vector<std::unique_ptr<Lane>> lanes_ IOTCLOUD_GUARDED_BY(mutex_);  ///< never removed from
  /// Lanes for threads that call run_now() or run_until_idle().
  std::vector<Lane*> unused_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<Lane*> homes_;  ///< the lanes of the pool's threads
  std::unique_ptr<Lane> spare_lane_;
  std::vector<std::jthread> pool_;
};

}  // namespace iotcloud::topology::internal
