#include <iotcloud/topology/runtime/scheduling/lane.h>

namespace iotcloud::topology::internal {

thread_local constinit Lane* lane_of_this_thread = nullptr;

void ReadyList::push(Runnable& task) {
  task.next_ready_ = nullptr;
  (last_ == nullptr ? first_ : last_->next_ready_) = &task;
  last_ = &task;
  ++size_;
}

Runnable* ReadyList::pop() {
  Runnable* task = first_;
  if (task == nullptr) return nullptr;
  first_ = task->next_ready_;
  if (first_ == nullptr) last_ = nullptr;
  --size_;
  return task;
}

void ReadyList::append(ReadyList& other) {
  if (other.empty()) return;
  (last_ == nullptr ? first_ : last_->next_ready_) = other.first_;
  last_ = other.last_;
  size_ += other.size_;
  other = ReadyList();
}

std::int64_t ReadyList::waiting_ns() const {
  std::int64_t sum = 0;
  for (const Runnable* task = first_; task != nullptr; task = task->next_ready_) sum += task->waiting_ns();
  return sum;
}

void Lane::push(Runnable& task) {
  const config::MutexLock lock(mutex_);
  ready_.push(task);
  ready_count_.store(ready_.size(), std::memory_order_relaxed);
}

Runnable* Lane::pop() {
  if (!has_ready()) return nullptr;
  const config::MutexLock lock(mutex_);
  Runnable* task = ready_.pop();
  ready_count_.store(ready_.size(), std::memory_order_relaxed);
  return task;
}

std::int64_t Lane::waiting_ns() {
  const config::MutexLock lock(mutex_);
  return ready_.waiting_ns();
}

void Lane::take_all(ReadyList& into) {
  const config::MutexLock lock(mutex_);
  into.append(ready_);
  ready_count_.store(0, std::memory_order_relaxed);
}

}  // namespace iotcloud::topology::internal
