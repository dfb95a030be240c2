#include <iotcloud/topology/runtime/scheduling/executors.h>

namespace iotcloud::topology::internal {

ReadyList Executors::set_limit(int limit) {
  const config::MutexLock lock(mutex_);
  limit_.store(limit, std::memory_order_relaxed);
  unlimited_.store(limit >= tasks_, std::memory_order_relaxed);
  ReadyList freed;
  while (!aside_.empty() && (limit >= tasks_ || busy_ + static_cast<int>(freed.size()) < limit)) {
    freed.push(*aside_.pop());
  }
  return freed;
}

bool Executors::enter(Runnable& task, bool& counted) {
  counted = false;
  if (unlimited_.load(std::memory_order_relaxed)) return true;
  const config::MutexLock lock(mutex_);
  if (unlimited_.load(std::memory_order_relaxed)) return true;
  if (busy_ >= limit()) {
    aside_.push(task);
    return false;
  }
  ++busy_;
  counted = true;
  return true;
}

Runnable* Executors::leave() {
  const config::MutexLock lock(mutex_);
  --busy_;
  return busy_ < limit() ? aside_.pop() : nullptr;
}

}  // namespace iotcloud::topology::internal
