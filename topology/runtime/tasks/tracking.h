#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/runtime/scheduling/pool.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::internal {

class Task;
class SpoutTask;

/// The tree of tuples that grows from one tracked emit of a spout: Storm's XOR acker without an acker task. `open` is
/// the XOR of the random ids of all deliveries that are neither acked nor given up, so it is zero when all are done
/// (wrongly so once in 2^64). A delivery changes it exactly once, with its own id and those of its children together;
/// so nobody but the owner and the deliveries may hold a tree, and it is recycled when both have let go.
struct Tree {
  static constexpr std::uint8_t failed = 1;
  static constexpr std::uint8_t lost = 2;  ///< a delivery was dropped without ack or fail: only time-out ends it

  std::atomic<std::uint64_t> open{0};
  std::atomic<std::uint8_t> flags{0};
  std::atomic<bool> posted{false};  ///< the owner was told, or has given up waiting
  std::atomic<std::uint8_t> holders{0};
  std::atomic<std::int64_t> touched_ns{0};  ///< when reset_timeout was called last; 0 = never

  // The owner's, a task at a time.
  SpoutTask* owner = nullptr;
  MessageId id = 0;
  std::int64_t emitted_ns = 0;
  bool abandoned = false;  ///< all deliveries are done, at least one of them by dropping it
  Tree* newer = nullptr;   ///< in a slot of the owner's timing wheel
  Tree* older = nullptr;
  std::size_t slot = 0;
  Tree* next_posted = nullptr;  ///< in the owner's stack of trees to look at

  static Tree* make(SpoutTask& owner, MessageId id, std::int64_t now_ns);
  /// One delivery is done. \param change its id and its children's.
  void close(std::uint64_t change, std::uint8_t flag) noexcept;
  void let_go() noexcept;
};

/// What one task owes for one tracked tuple.
struct Delivery {
  const Task* receiver = nullptr;
  std::uint64_t change = 0;      ///< XOR of its own id and the ids of what was emitted with it as the only anchor
  std::int64_t executed_ns = 0;  ///< when execute() was called, if that has returned without an answer; 0 = no
  bool settled = false;
};

/// A tuple as the runtime makes it: shared by all its receivers, recycled when the last handle is gone. What every
/// tuple needs stands in front, in the first two cache lines.
struct alignas(64) TupleCell final : public detail::TupleData {
  /// What few tuples need. Kept when the cell is recycled.
  struct More {
    std::vector<Tree*> trees;          ///< all but the first
    std::vector<Delivery> deliveries;  ///< all but the first receiver's
  };
  Delivery first;  ///< of the first receiver
  std::unique_ptr<More> more;

  static TupleCell* make() { return Pool<TupleCell>::take(); }
  void recycle() noexcept override;

  bool tracked() const { return tree != nullptr; }
  void track(std::span<Tree* const> trees) {
    tree = trees.front();
    if (trees.size() > 1) has_more().trees.assign(trees.begin() + 1, trees.end());
  }
  void add_delivery(const Task* receiver, std::uint64_t id) {
    const Delivery delivery{receiver, id, 0, false};
    if (first.receiver == nullptr) {
      first = delivery;
    } else {
      has_more().deliveries.push_back(delivery);
    }
  }
  /// The receiver's delivery that is not settled yet, or nullptr.
  Delivery* open_delivery(const Task* receiver);
  template <typename Call>
  void for_each_tree(Call&& call) const {
    call(tree);
    if (!more) return;
    for (Tree* other : more->trees) call(other);
  }
  void settle(Delivery& delivery, std::uint8_t flag) noexcept {
    delivery.settled = true;
    for_each_tree([&](Tree* each) { each->close(delivery.change, flag); });
  }

 private:
  More& has_more() {
    if (!more) more = std::make_unique<More>();
    return *more;
  }
};

inline TupleCell* cell_of(const Tuple& tuple) {
  return static_cast<TupleCell*>(tuple.data());
}

}  // namespace iotcloud::topology::internal
