#include <algorithm>

#include <iotcloud/topology/runtime/tasks/mailbox.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

namespace {

constexpr std::size_t ahead = 4;

}  // namespace

Mailbox::Mailbox(const Task& owner, std::size_t capacity, std::vector<KeepLast> keep_last)
    : owner_(owner),
      capacity_(std::max<std::size_t>(capacity, 2)),
      conflater_(keep_last.empty() ? nullptr : std::make_unique<Conflater>(std::move(keep_last))) {}

void Mailbox::put(std::span<TupleCell* const> cells) {
  if (conflater_) {
    put_conflated(cells);
    return;
  }
  const config::MutexLock lock(mutex_);
  waiting_.insert(waiting_.end(), cells.begin(), cells.end());
  depth_.fetch_add(cells.size());
}

void Mailbox::put_conflated(std::span<TupleCell* const> cells) {
  std::vector<TupleCell*> replaced;
  {
    const config::MutexLock lock(mutex_);
    for (TupleCell* cell : cells) {
      if (auto* oldest = static_cast<TupleCell*>(conflater_->put(cell))) replaced.push_back(oldest);
    }
    depth_.fetch_add(cells.size() - replaced.size());
  }
  superseded_.fetch_add(replaced.size(), std::memory_order_relaxed);
  for (TupleCell* cell : replaced) {
    if (TrackedDelivery* delivery = cell->tracked() ? cell->open_delivery(&owner_) : nullptr) {
      cell->settle(*delivery, std::uint8_t{0});
    }
    static_cast<void>(Tuple::adopt(cell));
  }
}

bool Mailbox::block_until_room(Task& emitter) {
  const config::MutexLock lock(mutex_);
  if (std::find(blocked_.begin(), blocked_.end(), &emitter) != blocked_.end()) return true;
  // This sets has_blocked_ and then reads depth_; done() lowers depth_ and then reads has_blocked_. So at least one of
  // the two sees what the other one wrote, and no emitter stays blocked.
  has_blocked_.store(true);
  if (depth_.load() <= capacity_ / 2) {
    has_blocked_.store(!blocked_.empty());
    return false;
  }
  blocked_.push_back(&emitter);
  emitter.block();
  return true;
}

TupleCell* Mailbox::next() {
  if (next_ < batch_.size()) {
    if (next_ + ahead < batch_.size()) {
      const auto* soon = reinterpret_cast<const char*>(batch_[next_ + ahead]);
      __builtin_prefetch(soon, 1);
      __builtin_prefetch(soon + 64, 1);
    }
    return batch_[next_++];
  }
  if (conflater_) {
    const config::MutexLock lock(mutex_);
    return static_cast<TupleCell*>(conflater_->take());
  }
  batch_.clear();
  next_ = 0;
  {
    const config::MutexLock lock(mutex_);
    batch_.swap(waiting_);
  }
  return batch_.empty() ? nullptr : batch_[next_++];
}

void Mailbox::done(std::size_t executed) {
  const std::size_t left = depth_.fetch_sub(executed) - executed;
  if (left > capacity_ / 2 || !has_blocked_.load()) return;
  freed_.clear();
  {
    const config::MutexLock lock(mutex_);
    freed_.swap(blocked_);
    has_blocked_.store(false);
  }
  for (Task* emitter : freed_) emitter->unblock();
}

void Mailbox::discard() {
  while (TupleCell* cell = next()) static_cast<void>(Tuple::adopt(cell));
}

}  // namespace iotcloud::topology::internal
