#include <utility>
#include <vector>

#include <iotcloud/topology/storm/shim/kept_tuples.h>

namespace iotcloud::topology::storm {

Tuple KeptTuples::put(const Tuple& tuple) {
  const config::MutexLock lock(mutex_);
  if (waiting_.find(tuple.data()->stream) == nullptr) {
    while (!ended_ && unlimited_ >= capacity) changed_.wait(mutex_);
    if (!ended_) ++unlimited_;
  }
  if (ended_) return {};
  tuple.data()->handles.fetch_add(1, std::memory_order_relaxed);  // the queue's
  changed_.notify_all();
  return Tuple::adopt(waiting_.put(tuple.data()));
}

void KeptTuples::request_tick() {
  const config::MutexLock lock(mutex_);
  tick_ = true;
  changed_.notify_all();
}

void KeptTuples::wake() {
  const config::MutexLock lock(mutex_);
  woken_ = true;
  changed_.notify_all();
}

KeptTuples::Next KeptTuples::next() {
  Next next;
  const config::MutexLock lock(mutex_);
  while (!ended_) {
    next.tick = std::exchange(tick_, false);
    next.tuple = Tuple::adopt(waiting_.take());
    if (next.tick || next.tuple || std::exchange(woken_, false)) break;
    changed_.wait(mutex_);
  }
  next.end = ended_;
  if (next.tuple && waiting_.find(next.tuple.data()->stream) == nullptr) {
    --unlimited_;
    changed_.notify_all();
  }
  return next;
}

void KeptTuples::end() {
  std::vector<Tuple> dropped;  // declared before the lock: the last handle of a tuple tells Java, without the lock
  const config::MutexLock lock(mutex_);
  ended_ = true;
  while (detail::TupleData* data = waiting_.take()) dropped.push_back(Tuple::adopt(data));
  unlimited_ = 0;
  changed_.notify_all();
}

}  // namespace iotcloud::topology::storm
