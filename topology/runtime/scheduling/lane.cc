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

std::int64_t ReadyList::worth_moving_ns() const {
  std::int64_t sum = 0;
  for (const Runnable* task = first_; task != nullptr; task = task->next_ready_) sum += task->worth_moving_ns();
  return sum;
}

void Lane::push(Runnable& task) {
  const config::MutexLock lock(mutex_);
  push_locked(task, now_ns);
}

void Lane::push_locked(Runnable& task, std::int64_t since_ns) {
  if (task.role_ == Runnable::Role::worker) {
    ready_.push(task);
  } else {
    if (sources_.empty()) sources_since_ns_ = since_ns;
    sources_.push(task);
  }
  ready_count_.store(ready_.size() + sources_.size(), std::memory_order_relaxed);
}

Runnable* Lane::pop() {
  if (ready_count() == 0) return nullptr;
  const config::MutexLock lock(mutex_);
  return pop_locked();
}

Runnable* Lane::pop_locked() {
  const bool source = ready_.empty() || (!sources_.empty() && now_ns - sources_since_ns_ > longest_wait_ns);
  Runnable* task = source ? sources_.pop() : ready_.pop();
  if (source) sources_since_ns_ = now_ns;
  ready_count_.store(ready_.size() + sources_.size(), std::memory_order_relaxed);
  return task;
}

void Lane::wake() {
  const config::MutexLock lock(mutex_);
  awake_ = true;
}

bool Lane::push_if_awake(Runnable& task, std::int64_t now) {
  const config::MutexLock lock(mutex_);
  if (awake_) push_locked(task, now);
  return awake_;
}

Runnable* Lane::pop_or_sleep() {
  const config::MutexLock lock(mutex_);
  Runnable* task = pop_locked();
  awake_ = task != nullptr;
  return task;
}

std::int64_t Lane::worth_moving_ns() {
  const config::MutexLock lock(mutex_);
  return ready_.worth_moving_ns() + sources_.worth_moving_ns();
}

void Lane::take_all(ReadyList& into) {
  const config::MutexLock lock(mutex_);
  take_all_locked(into);
}

void Lane::sleep(ReadyList& into) {
  const config::MutexLock lock(mutex_);
  take_all_locked(into);
  awake_ = false;
}

void Lane::take_all_locked(ReadyList& into) {
  into.append(ready_);
  into.append(sources_);
  ready_count_.store(0, std::memory_order_relaxed);
}

}  // namespace iotcloud::topology::internal
