#include <iotcloud/topology/runtime/tasks/spout_task.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

Tree* Tree::make(SpoutTask& owner, MessageId id, std::int64_t now_ns) {
  Tree* tree = Pool<Tree>::take();
  tree->open.store(0, std::memory_order_relaxed);
  tree->flags.store(0, std::memory_order_relaxed);
  tree->posted.store(false, std::memory_order_relaxed);
  tree->touched_ns.store(0, std::memory_order_relaxed);
  tree->holders.store(2, std::memory_order_relaxed);
  tree->owner = &owner;
  tree->id = id;
  tree->emitted_ns = now_ns;
  tree->abandoned = false;
  tree->newer = tree->older = tree->next_posted = nullptr;
  return tree;
}

void Tree::close(std::uint64_t change, std::uint8_t flag) noexcept {
  if (flag != 0) flags.fetch_or(flag, std::memory_order_acq_rel);
  // Tells the spout of a failure at once, without waiting for the rest of the tree.
  if ((flag & failed) != 0 && !posted.exchange(true, std::memory_order_acq_rel)) owner->post(*this);
  if ((open.fetch_xor(change, std::memory_order_acq_rel) ^ change) != 0) return;
  if (!posted.exchange(true, std::memory_order_acq_rel)) owner->post(*this);
  let_go();
}

void Tree::let_go() noexcept {
  if (holders.fetch_sub(1, std::memory_order_acq_rel) != 1) return;
  origin.reset();
  Pool<Tree>::give(this);
}

void TupleCell::recycle() noexcept {
  if (tracked()) {
    const auto give_up = [this](TrackedDelivery& delivery) {
      if (delivery.receiver != nullptr && !delivery.settled) settle(delivery, Tree::lost);
    };
    give_up(first);
    if (more) {
      for (TrackedDelivery& delivery : more->deliveries) give_up(delivery);
      more->trees.clear();
      more->deliveries.clear();
    }
    tree = nullptr;
    first.receiver = nullptr;
  }
  values.clear();
  Pool<TupleCell>::give(this);
}

TrackedDelivery* TupleCell::open_delivery(const Task* receiver) {
  if (first.receiver == receiver && !first.settled) return &first;
  if (!more) return nullptr;
  for (TrackedDelivery& delivery : more->deliveries) {
    if (delivery.receiver == receiver && !delivery.settled) return &delivery;
  }
  return nullptr;
}

}  // namespace iotcloud::topology::internal
