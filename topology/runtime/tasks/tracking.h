#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/runtime/tasks/flat_list.h>
#include <iotcloud/topology/runtime/tasks/pool.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::internal {

class SpoutTask;
class Task;

/// The tree of tuples that grows from one tracked emit of a spout: Storm's XOR acker, which is the spout's task itself.
/// `open` is the XOR of the random ids of all deliveries that are not settled, so it is zero when all are settled (and,
/// with a probability of 2^-64, by chance before). Settling a delivery changes `open` exactly once, by its own id and
/// the ids of its children together. A tuple that is acked in the very call that emitted its first child leaves all of
/// that to this child, and changes nothing: so a chain of bolts settles a tree once, at its end. Only the slices of its
/// task change a tree: bolts send them Settlements. So no change needs an atomic operation. The tree is recycled when
/// its task has told the spout of its end and all deliveries are settled.
struct alignas(64) Tree {
  static constexpr std::uint8_t failed = 1;
  /// A bolt dropped a tuple without ack or fail: only the time-out ends the tree.
  static constexpr std::uint8_t lost = 2;
  /// With `failed`: something is wrong with the message, so that its spout counts the try.
  static constexpr std::uint8_t blamed = 4;
  /// The id of a root's delivery when it has one receiver: no other delivery of the tree has one that is not random.
  static constexpr std::uint64_t only_root = 1;

  // Constant while deliveries are open, for any thread; and the one thing that any thread changes.
  SpoutTask* owner = nullptr;
  std::atomic<std::int64_t> touched_ns{0};  ///< when reset_timeout() was called last, by the topology's clock; 0: never
  bool has_origin = false;

  // For the owner; only its slices use these.
  bool ending = false;     ///< it is done or failed, and the spout is told or soon will be
  bool ended = false;      ///< the spout was told
  bool abandoned = false;  ///< all deliveries are settled, at least one because a bolt dropped its tuple
  std::uint8_t flags = 0;
  std::uint8_t slot = 0;  ///< of the owner's timing wheel
  std::uint64_t open = 0;
  MessageId id = 0;
  std::int64_t emitted_ns = 0;
  Tree* newer = nullptr;  ///< neighbours in a slot of the wheel
  Tree* older = nullptr;

  std::shared_ptr<const TupleOrigin> origin;  ///< set if `has_origin`; constant, as `owner` is

  using Recycled = Pool<Tree>::Cache;

  [[gnu::always_inline]] static Tree* make(Recycled& recycled, SpoutTask& owner, MessageId id, std::int64_t now_ns) {
    Tree* tree = recycled.take();
    tree->owner = &owner;
    tree->touched_ns.store(0, std::memory_order_relaxed);
    tree->has_origin = tree->ending = tree->ended = tree->abandoned = false;
    tree->flags = 0;
    tree->id = id;
    tree->emitted_ns = now_ns;
    return tree;
  }
  void set_origin(std::shared_ptr<const TupleOrigin> from) {
    has_origin = from != nullptr;
    origin = std::move(from);
  }
  /// \pre no delivery is open, and the tree is in no slot of the wheel.
  void recycle() noexcept { recycle(Pool<Tree>::local()); }
  [[gnu::always_inline]] void recycle(Recycled& recycled) noexcept {
    if (has_origin) origin.reset();
    recycled.give(this);
  }
};

/// What a bolt's task tells the owner of a tree.
struct Settlement {
  Settlement() noexcept {}  // NOLINT(cppcoreguidelines-pro-type-member-init): memory of a list, written when it is used
  /// \param settles XOR of the id of the settled delivery (0: none) and the ids of new deliveries.
  /// \param how 0 for an ack, or Tree's constants.
  Settlement(Tree& of, std::uint64_t settles, std::uint8_t how) : tree(&of), change(settles), flag(how) {}
  Tree* tree;
  std::uint64_t change;
  std::uint8_t flag;
};

/// What only tuples with several trees or receivers use.
struct MoreDeliveries {
  std::vector<Tree*> trees;                  ///< all trees but the first
  std::vector<detail::Delivery> deliveries;  ///< all deliveries but the first
};

/// A tuple as the runtime makes it: shared by all its receivers, recycled when the last handle is destroyed.
struct alignas(64) TupleCell final : public detail::TupleData {
  ~TupleCell() override { delete more; }

  using Recycled = Pool<TupleCell>::Cache;

  void recycle() noexcept override { recycle(Pool<TupleCell>::local()); }
  [[gnu::always_inline]] void recycle(Recycled& recycled) noexcept {
    if (tracked()) {
      if (first.is_open() || more != nullptr) forget_deliveries();
      first.receiver = nullptr;
      tree = nullptr;
    }
    values.clear();
    recycled.give(this);
  }

  bool tracked() const { return tree != nullptr; }
  void track(std::span<Tree* const> trees) {
    tree = trees.front();
    if (trees.size() > 1) make_more().trees.assign(trees.begin() + 1, trees.end());
  }
  /// \pre no delivery of the tuple is settled yet.
  [[gnu::always_inline]] void add_delivery(const Task* receiver, std::uint64_t id) {
    // Member by member: a copy reads 16 bytes that were written in parts just before, for which the processor waits.
    detail::Delivery& delivery = first.receiver == nullptr ? first : next_delivery();
    delivery.receiver = receiver;
    delivery.change = id;
    delivery.executed_ns = 0;
  }
  /// \return the first delivery to this receiver that is not settled, or nullptr.
  detail::Delivery* open_delivery(const Task* receiver) {
    if (first.is_open_for(receiver)) return &first;
    return more == nullptr ? nullptr : find_more(receiver);
  }
  bool has_one_tree() const { return more == nullptr || more->trees.empty(); }
  template <typename Call>
  void for_each_tree(Call&& call) const {
    call(tree);
    if (more == nullptr) return;
    for (Tree* other : more->trees) call(other);
  }

 private:
  MoreDeliveries& make_more() {
    if (more == nullptr) more = new MoreDeliveries;
    return *more;
  }
  [[gnu::noinline]] detail::Delivery& next_delivery() { return make_more().deliveries.emplace_back(); }
  [[gnu::noinline]] detail::Delivery* find_more(const Task* receiver);
  [[gnu::noinline]] void forget_deliveries() noexcept;
};

/// Calls `call` for each trace that follows a message of the tuple. \pre a delivery of the tuple is open, or was
/// settled by the running slice.
template <typename Call>
void for_each_trace(const TupleCell& cell, Call&& call) {
  if (!cell.tracked()) return;
  cell.for_each_tree([&](const Tree* tree) {
    if (!tree->has_origin) return;
    if (TupleTrace* const trace = tree->origin->trace()) call(*trace);
  });
}

// All that a tuple of one value and one receiver needs is in two cache lines. The values, which are the last member,
// have room for four.
static_assert(alignof(TupleCell) == 64 && sizeof(detail::TupleData) - 3 * sizeof(Value) <= 128);

using CellList = FlatList<TupleCell*>;

inline TupleCell* cell_of(const Tuple& tuple) {
  return static_cast<TupleCell*>(tuple.data());
}

}  // namespace iotcloud::topology::internal
