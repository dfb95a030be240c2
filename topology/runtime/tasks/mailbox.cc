#include <algorithm>

#include <iotcloud/topology/runtime/tasks/mailbox.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

namespace {

constexpr std::size_t ahead = 4;

void append_bytes(std::string& key, const void* data, std::size_t size) {
  key.append(static_cast<const char*>(data), size);
}

/// Appends the kind, and before a string's or payload's bytes their number, so that different values never give equal
/// keys.
void append_value(std::string& key, const Value& value) {
  key.push_back(static_cast<char>(value.index()));
  const auto append_sized = [&key](const void* data, std::size_t size) {
    append_bytes(key, &size, sizeof size);
    append_bytes(key, data, size);
  };
  if (const auto* b = std::get_if<bool>(&value)) key.push_back(*b ? 1 : 0);
  if (const auto* i = std::get_if<std::int64_t>(&value)) append_bytes(key, i, sizeof *i);
  if (const auto* d = std::get_if<double>(&value)) append_bytes(key, d, sizeof *d);
  if (const auto* s = std::get_if<std::string>(&value)) append_sized(s->data(), s->size());
  if (const auto* p = std::get_if<Payload>(&value)) append_sized(p->data(), p->size());
}

}  // namespace

// keep_last.

std::string Conflater::key_of(const KeepLast& input, const TupleCell& cell) const {
  // Two inputs may have equal keys: the stream's address tells them apart.
  const auto stream = reinterpret_cast<std::uintptr_t>(input.stream);
  std::string key;
  append_bytes(key, &stream, sizeof stream);
  for (const std::size_t position : input.key) append_value(key, cell.values[position]);
  return key;
}

TupleCell* Conflater::put(TupleCell* cell) {
  const auto input =
      std::find_if(inputs_.begin(), inputs_.end(), [&](const auto& i) { return i.stream == cell->stream; });
  if (input == inputs_.end()) {
    line_.push_back({cell, nullptr});
    return nullptr;
  }
  // the map never moves its keys, so line_ may point to them
  const auto at = by_key_.try_emplace(key_of(*input, *cell)).first;
  Kept& kept = at->second;
  kept.push_back(cell);
  if (kept.size() <= input->keep) {
    line_.push_back({nullptr, &at->first});
    return nullptr;
  }
  TupleCell* oldest = kept.front();
  kept.pop_front();
  return oldest;
}

TupleCell* Conflater::take() {
  if (line_.empty()) return nullptr;
  const Place place = line_.front();
  line_.pop_front();
  if (place.cell != nullptr) return place.cell;
  const auto at = by_key_.find(*place.key);
  TupleCell* cell = at->second.front();
  at->second.pop_front();
  if (at->second.empty()) by_key_.erase(at);
  return cell;
}

// The mailbox.

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
      if (TupleCell* oldest = conflater_->put(cell)) replaced.push_back(oldest);
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
    return conflater_->take();
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
