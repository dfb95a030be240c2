#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/runtime/tasks/pool.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::internal {

class Task;
class SpoutTask;

/// The tree of tuples that grows from one tracked emit of a spout: Storm's XOR acker without an acker task. `open` is
/// the XOR of the random ids of all deliveries that are not settled, so it is zero when all are settled (and, with a
/// probability of 2^-64, by chance before). Settling a delivery changes `open` exactly once, by its own id and the ids
/// of its children together. A tree has two holders, the owner and the open deliveries together; it is recycled when
/// both have let go.
struct Tree {
  static constexpr std::uint8_t failed = 1;
  /// A bolt dropped a tuple without ack or fail: only the time-out ends the tree.
  static constexpr std::uint8_t lost = 2;
  /// With `failed`: something is wrong with the message, so that its spout counts the try.
  static constexpr std::uint8_t blamed = 4;

  std::atomic<std::uint64_t> open{0};
  std::atomic<std::uint8_t> flags{0};
  std::atomic<bool> posted{false};  ///< SpoutTask::post() was called for the tree, or the time-out ended it
  std::atomic<std::uint8_t> holders{0};
  std::atomic<std::int64_t> touched_ns{0};  ///< when reset_timeout() was called last, by the topology's clock; 0: never

  // For the owner; only its slices use these.
  SpoutTask* owner = nullptr;
  MessageId id = 0;
  std::shared_ptr<const TupleOrigin> origin;  ///< may be null; holders of the tree may ask it
  std::int64_t emitted_ns = 0;
  bool abandoned = false;  ///< all deliveries are settled, at least one because a bolt dropped its tuple
  Tree* newer = nullptr;   ///< neighbours in a slot of the owner's timing wheel
  Tree* older = nullptr;
  std::size_t slot = 0;         ///< of the timing wheel
  Tree* next_posted = nullptr;  ///< the next one in the owner's stack of posted trees

  static Tree* make(SpoutTask& owner, MessageId id, std::int64_t now_ns);
  /// Settles one delivery. \param change XOR of its id and its children's ids. \param flag 0 for an ack, or the
  /// constants above.
  void close(std::uint64_t change, std::uint8_t flag) noexcept;
  void let_go() noexcept;
};

/// One task's delivery of a tracked tuple: what is needed to settle it.
struct TrackedDelivery {
  const Task* receiver = nullptr;
  std::uint64_t change = 0;      ///< XOR of its own id and the ids of what was emitted with it as the only anchor
  std::int64_t executed_ns = 0;  ///< real_ns() of the execute() that returned without ack or fail; 0: none did
  bool settled = false;          ///< acked, failed or dropped
};

/// A tuple as the runtime makes it: shared by all its receivers, recycled when the last handle is destroyed. The
/// members that every tuple uses are in its first two cache lines.
struct alignas(64) TupleCell final : public detail::TupleData {
  /// Members that only tuples with several trees or receivers use. Kept when the cell is recycled.
  struct More {
    std::vector<Tree*> trees;                 ///< all trees but the first
    std::vector<TrackedDelivery> deliveries;  ///< all deliveries but `first`
  };
  TrackedDelivery first;  ///< delivery to the first receiver
  std::unique_ptr<More> more;

  static TupleCell* make() { return Pool<TupleCell>::take(); }
  void recycle() noexcept override;

  bool tracked() const { return tree != nullptr; }
  void track(std::span<Tree* const> trees) {
    tree = trees.front();
    if (trees.size() > 1) make_more().trees.assign(trees.begin() + 1, trees.end());
  }
  void add_delivery(const Task* receiver, std::uint64_t id) {
    // Member by member: a copy reads 16 bytes that were written in parts just before, for which the processor waits.
    TrackedDelivery& delivery = first.receiver == nullptr ? first : make_more().deliveries.emplace_back();
    delivery.receiver = receiver;
    delivery.change = id;
    delivery.executed_ns = 0;
    delivery.settled = false;
  }
  /// \return the first delivery to this receiver that is not settled, or nullptr.
  TrackedDelivery* open_delivery(const Task* receiver);
  template <typename Call>
  void for_each_tree(Call&& call) const {
    call(tree);
    if (!more) return;
    for (Tree* other : more->trees) call(other);
  }
  /// Settles a delivery in all trees of the tuple. \param flag as for Tree::close().
  void settle(TrackedDelivery& delivery, std::uint8_t flag) noexcept {
    delivery.settled = true;
    for_each_tree([&](Tree* each) { each->close(delivery.change, flag); });
  }

 private:
  More& make_more() {
    if (!more) more = std::make_unique<More>();
    return *more;
  }
};

inline TupleCell* cell_of(const Tuple& tuple) {
  return static_cast<TupleCell*>(tuple.data());
}

}  // namespace iotcloud::topology::internal
