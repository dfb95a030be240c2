#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/executors.h>
#include <iotcloud/topology/runtime/scheduling/lane.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

class Timers;

/// Decides which thread runs which task. A task that becomes ready on a thread that runs tasks goes to the end of that
/// thread's own run list: no other thread is woken. Work moves to the pool when a thread that is not the pool's has
/// done its slice, when a pool thread is behind while another one sleeps, or when a thread stays long in one task
/// (look()).
class Scheduler {
 public:
  /// \param tasks highest task id.
  Scheduler(unsigned threads, std::chrono::microseconds caller_slice, std::chrono::microseconds long_slice,
            std::size_t tasks, Timers& timers);
  ~Scheduler();

  void start();
  /// No task starts a slice any more, anywhere. Does not wait.
  void halt();
  /// Waits for the slices that run. \return false when `deadline` passed first. After halt().
  bool wait_halted(std::chrono::steady_clock::time_point deadline);
  /// Joins the pool; waits as long as user code runs. After halt().
  void join();
  /// Whether some thread runs the task's slice. After halt() this only turns from true to false.
  bool runs(const Task& task) const;

  /// There is news for the task: it gets a slice. Any thread.
  void schedule(Task& task) noexcept;
  /// As schedule(), but an idle task, and what it makes ready, runs on this thread.
  void run_now(Task& task) noexcept;
  /// A task that was held since it was made may run; with news (or `ready`) it does.
  void release(Task& task, bool ready);
  void run_until_idle();

  bool idle() const { return busy_.load() == 0; }
  /// Waits until no task has work and `condition` holds. \return false when `deadline` passed first.
  bool wait_idle(std::chrono::steady_clock::time_point deadline, const std::function<bool()>& condition);

  /// Frees run lists of threads that have been in one task for about a millisecond.
  /// \return true when there is something to look at again soon.
  bool look();

  /// Reports user code that has not returned for `limit` as an error of its task, once for each such time.
  void report_hanging(std::chrono::milliseconds limit);
  void set_limit(Executors& executors, int limit);

  /// For user code that is called outside of slices (open, prepare).
  Lane& spare_lane() { return *spare_lane_; }

 private:
  enum class Kind { pool, caller, only };
  void run(Lane& lane, Kind kind) noexcept;
  void run_slice(Lane& lane, Task& task) noexcept;
  /// \return true when the task was idle: it is to be put on a run list by the caller.
  bool make_ready(Task& task) noexcept;
  void now_idle() noexcept;
  void hand_over(ReadyList& tasks) noexcept;
  void hand_over(Task& task) noexcept;
  bool share(Lane& lane, Kind kind, std::int64_t busy_ns) noexcept;
  void pool_thread(Lane& lane);
  std::unique_ptr<Lane> new_lane();
  Lane* borrow_lane();
  void return_lane(Lane* lane);

  const unsigned threads_;
  const std::int64_t caller_slice_ns_, long_slice_ns_;
  const std::size_t tasks_;
  Timers& timers_;
  std::atomic<bool> halted_{false};
  std::atomic<std::int64_t> busy_{0};  ///< tasks that are not idle
  std::atomic<bool> waited_for_{false};
  std::atomic<std::size_t> shared_count_{0};
  std::atomic<unsigned> sleeping_{0};

  mutable std::mutex mutex_;
  std::condition_variable work_;              ///< the pool waits here
  std::condition_variable changed_;           ///< wait_idle and wait_halted wait here
  ReadyList shared_;                          ///< guarded by mutex_
  std::vector<std::unique_ptr<Lane>> lanes_;  ///< guarded by mutex_: all lanes; grows only
  std::vector<Lane*> unused_;                 ///< guarded by mutex_: for callers
  std::unique_ptr<Lane> spare_lane_;
  std::vector<std::jthread> pool_;
};

}  // namespace iotcloud::topology::internal
