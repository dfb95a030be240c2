#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <utility>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;
class Scheduler;
class Task;

/// Tasks that are ready, first in, first out. Intrusive: no memory of its own. Not thread safe.
class ReadyList {
 public:
  bool empty() const { return first_ == nullptr; }
  std::size_t size() const { return size_; }
  const Task* first() const { return first_; }
  void push(Task& task);
  Task* pop();
  void append(ReadyList& other);  ///< leaves `other` empty

 private:
  Task* first_ = nullptr;
  Task* last_ = nullptr;
  std::size_t size_ = 0;
};

/// One thread that runs tasks: its run list and what the running task has emitted but not handed over yet. A thread of
/// the pool has its own for ever, a thread that calls wake() borrows one.
class Lane {
 public:
  Lane(Scheduler& scheduler, std::size_t tasks, std::uint64_t seed);

  Scheduler& scheduler() { return scheduler_; }
  /// The task whose user code runs on this thread; set by OwnCall.
  const Task* current = nullptr;
  /// real_ns() at the last look, which is when this slice or chunk began: a look costs as much as a quick call.
  std::int64_t now_ns = 0;
  std::uint64_t time_since_last_look() {
    const std::int64_t before = std::exchange(now_ns, real_ns());
    return static_cast<std::uint64_t>(now_ns - before);
  }

  // What the running task emits.
  void put(BoltTask& target, TupleCell* cell) {
    if (last_out_ == nullptr || last_out_->target != &target) last_out_ = &out_to(target);
    auto& cells = last_out_->cells;
    cells.push_back(cell);
    // Others may put as many: half of the room is ours.
    if (2 * cells.size() >= last_out_->room) wants_flush_ = true;
  }
  /// Hands everything over and makes the receivers ready; `emitter` waits for those that are full.
  void flush(Task& emitter);
  bool wants_flush() const { return wants_flush_; }

  /// 64 random bits, for the acker (splitmix64).
  std::uint64_t random() {
    std::uint64_t z = (random_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }

  // The run list. Another thread takes from it when this one is long in user code.
  void push(Task& task);
  Task* pop();
  void take_all(ReadyList& into);
  std::size_t ready_count() const { return ready_count_.load(std::memory_order_relaxed); }
  bool has_ready() const { return ready_count() > 0; }
  std::int64_t waiting_ns();  ///< about how long the tasks on the run list will take
  // For those who watch.
  std::atomic<std::int64_t> slice_began_ns{0};    ///< real_ns(); 0 = no slice runs
  std::atomic<Task*> running{nullptr};            ///< the task whose slice it is
  std::atomic<std::int64_t> reported_hang_ns{0};  ///< slice_began_ns of the last one that was reported as hanging

  /// The lane of the calling thread, if it runs tasks.
  static Lane* of_this_thread();

 private:
  struct Out {
    BoltTask* target = nullptr;
    std::size_t room = 0;  ///< so many cells fit before the target is full
    std::vector<TupleCell*> cells;
  };
  Out& out_to(BoltTask& target);

  Scheduler& scheduler_;
  std::vector<std::uint32_t> out_of_task_;  ///< by task id: index into outs_ plus 1, 0 = none
  std::vector<Out> outs_;                   ///< never shrinks: keeps its cells' memory
  std::size_t outs_used_ = 0;
  Out* last_out_ = nullptr;  ///< of the last put()
  bool wants_flush_ = false;
  std::uint64_t random_;

  std::atomic<std::size_t> ready_count_{0};
  std::mutex mutex_;
  ReadyList ready_;  ///< guarded by mutex_
};

// The runtime is linked into programs, never loaded by itself: a direct access, without a call.
extern thread_local constinit Lane* lane_of_this_thread __attribute__((tls_model("initial-exec")));

inline Lane* Lane::of_this_thread() {
  return lane_of_this_thread;
}

/// While it lives the calling thread is in the task's own calls.
class OwnCall {
 public:
  OwnCall(Lane& lane, const Task& task) : lane_(lane), outer_lane_(lane_of_this_thread), outer_(lane.current) {
    lane_of_this_thread = &lane;
    lane.current = &task;
  }
  ~OwnCall() {
    lane_.current = outer_;
    lane_of_this_thread = outer_lane_;
  }
  OwnCall(const OwnCall&) = delete;
  OwnCall& operator=(const OwnCall&) = delete;

  static bool is_of(const Task& task) {
    return lane_of_this_thread != nullptr && lane_of_this_thread->current == &task;
  }

 private:
  Lane& lane_;
  Lane* outer_lane_;
  const Task* outer_;
};

}  // namespace iotcloud::topology::internal
