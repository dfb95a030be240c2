#include <iotcloud/topology/runtime/scheduling/lane.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>

namespace iotcloud::topology::internal {

thread_local constinit Lane* lane_of_this_thread = nullptr;

void ReadyList::push(Task& task) {
  task.next_ready = nullptr;
  (last_ == nullptr ? first_ : last_->next_ready) = &task;
  last_ = &task;
  ++size_;
}

Task* ReadyList::pop() {
  Task* task = first_;
  if (task == nullptr) return nullptr;
  first_ = task->next_ready;
  if (first_ == nullptr) last_ = nullptr;
  --size_;
  return task;
}

void ReadyList::append(ReadyList& other) {
  if (other.empty()) return;
  (last_ == nullptr ? first_ : last_->next_ready) = other.first_;
  last_ = other.last_;
  size_ += other.size_;
  other = ReadyList();
}

Lane::Lane(Scheduler& scheduler, std::size_t tasks, std::uint64_t seed)
    : scheduler_(scheduler), out_of_task_(tasks + 1, 0), random_(seed) {}

Lane::Out& Lane::out_to(BoltTask& target) {
  std::uint32_t& slot = out_of_task_[static_cast<std::size_t>(target.id())];
  if (slot == 0) {
    if (outs_used_ == outs_.size()) {
      outs_.emplace_back();
      last_out_ = nullptr;
    }
    Out& out = outs_[outs_used_];
    out.target = &target;
    out.room = target.room();
    slot = static_cast<std::uint32_t>(++outs_used_);
  }
  return outs_[slot - 1];
}

void Lane::flush(Task& emitter) {
  for (std::size_t i = 0; i < outs_used_; ++i) {
    Out& out = outs_[i];
    out_of_task_[static_cast<std::size_t>(out.target->id())] = 0;
    out.target->deliver(out.cells);
    out.cells.clear();
    if (out.target->room() == 0) out.target->block_until_room(emitter);
    scheduler_.schedule(*out.target);
  }
  outs_used_ = 0;
  last_out_ = nullptr;
  wants_flush_ = false;
}

void Lane::push(Task& task) {
  const std::lock_guard lock(mutex_);
  ready_.push(task);
  ready_count_.store(ready_.size(), std::memory_order_relaxed);
}

Task* Lane::pop() {
  if (!has_ready()) return nullptr;
  const std::lock_guard lock(mutex_);
  Task* task = ready_.pop();
  ready_count_.store(ready_.size(), std::memory_order_relaxed);
  return task;
}

std::int64_t Lane::waiting_ns() {
  const std::lock_guard lock(mutex_);
  std::int64_t sum = 0;
  for (const Task* task = ready_.first(); task != nullptr; task = task->next_ready) sum += task->waiting_ns();
  return sum;
}

void Lane::take_all(ReadyList& into) {
  const std::lock_guard lock(mutex_);
  into.append(ready_);
  ready_count_.store(0, std::memory_order_relaxed);
}

}  // namespace iotcloud::topology::internal
