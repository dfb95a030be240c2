#include <algorithm>

#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/mailbox.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

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
  waiting_.append(cells);
  depth_.fetch_add(cells.size());
}

void Mailbox::hand(CellList& cells) {
  if (conflater_ || depth_.load() > 0) {
    put(cells);
    return;
  }
  batch_.swap(cells);
  next_ = 0;
  depth_.fetch_add(batch_.size());
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
    if (detail::Delivery* delivery = cell->tracked() ? cell->open_delivery(&owner_) : nullptr) {
      EmittingLane::settle_from_anywhere(*cell, *delivery, 0);
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

bool Mailbox::next_batch() {
  next_ = 0;
  batch_.clear();
  const config::MutexLock lock(mutex_);
  if (!conflater_) {
    batch_.swap(waiting_);
  } else if (auto* cell = static_cast<TupleCell*>(conflater_->take())) {
    batch_.push(cell);
  }
  return !batch_.empty();
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
  for (auto cells = next(); !cells.empty(); cells = next()) {
    for (TupleCell* cell : cells) static_cast<void>(Tuple::adopt(cell));
    took(cells.size());
  }
}

}  // namespace iotcloud::topology::internal
