#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/lane.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;
class SpoutTask;

/// A lane that also holds what the running task has emitted and settled, and not delivered yet. All lanes of a runtime
/// are of this class.
class EmittingLane final : public Lane {
 public:
  /// \param tasks the highest task id.
  EmittingLane(Scheduler& scheduler, std::size_t tasks);
  /// The argument of Runnable::slice() as an EmittingLane, which every lane of a runtime is.
  static EmittingLane& of(Lane& lane) { return static_cast<EmittingLane&>(lane); }

  /// Makes the lane ready for a slice, open() or prepare() on this thread.
  void begin() {
    cells_ = &Pool<TupleCell>::local();
    trees_ = &Pool<Tree>::local();
  }
  /// Recycled objects of the thread that runs the slice.
  TupleCell::Recycled& cells() { return *cells_; }
  Tree::Recycled& trees() { return *trees_; }

  [[gnu::always_inline]] void put(const Receiver& target, TupleCell* cell) {
    Out& out = *out_of_task_[target.id];
    *out.end++ = cell;
    if (out.end >= out.enough) has_enough(*target.task, out);
  }
  /// Tells the tree's owner, with the next flush. \param change what is settled. \param flag how, as in Settlement.
  [[gnu::always_inline]] void settle(Tree& tree, std::uint64_t change, std::uint8_t flag) {
    if (last_told_->owner != tree.owner) [[unlikely]]
      last_told_ = &told_to(*tree.owner);
    last_told_->settlements.push(Settlement(tree, change, flag));
  }
  /// Whether settle() only notes what it is told, so that it calls no other function.
  [[gnu::always_inline]] bool settles_at_once(const Tree& tree) const {
    return last_told_->owner == tree.owner && last_told_->settlements.has_room();
  }
  /// Settles a delivery in all trees of the tuple. \param flag as in Settlement.
  void settle(TupleCell& cell, detail::Delivery& delivery, std::uint8_t flag) {
    delivery.executed_ns = detail::Delivery::settled;
    cell.for_each_tree([&](Tree* tree) { settle(*tree, delivery.change, flag); });
  }
  /// The same, on any thread, in a task's call or not.
  static void settle_from_anywhere(TupleCell& cell, detail::Delivery& delivery, std::uint8_t flag) noexcept;

  /// Delivers everything to the receivers' mailboxes, tells the owners of trees what was settled, and makes them all
  /// ready. `emitter` does not run again until those mailboxes that are full have room.
  void flush(Task& emitter) {
    if (outs_used_ > 0) deliver(emitter);
    if (told_used_ > 0) tell();
  }
  /// Whether a receiver's mailbox may be full after a flush, so that no more should be emitted before it.
  bool wants_flush() const { return wants_flush_; }

  /// 64 random bits, for the id of a tracked delivery (splitmix64).
  std::uint64_t random() {
    std::uint64_t z = (random_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }

 private:
  /// The tuples for one receiver.
  struct Out {
    TupleCell** end = nullptr;     ///< of the cells
    TupleCell** enough = nullptr;  ///< when `end` comes here, wants_flush() is set or the memory is full
    BoltTask* target = nullptr;
    std::size_t room = 0;  ///< how many cells fitted into the target's mailbox at the first put()
    CellList cells;
  };
  /// What one spout's task is told.
  struct Told {
    SpoutTask* owner = nullptr;
    FlatList<Settlement> settlements;
  };
  [[gnu::noinline]] void has_enough(BoltTask& target, Out& out);
  [[gnu::noinline]] void put_first(BoltTask& target);
  [[gnu::noinline]] Told& told_to(SpoutTask& owner);
  void deliver(Task& emitter);
  void deliver(Task& emitter, Out& out, bool first);
  void tell();

  TupleCell::Recycled* cells_ = nullptr;
  Tree::Recycled* trees_ = nullptr;
  /// Index: task id. A task that nothing was put for has `nowhere_`, whose end is its `enough` after the first put().
  std::vector<Out*> out_of_task_;
  std::vector<std::unique_ptr<Out>> outs_;  ///< never shrinks, to keep the memory of the cells
  std::size_t outs_used_ = 0;
  TupleCell* first_cell_ = nullptr;
  Out nowhere_;
  std::vector<Told> told_;  ///< never shrinks, either
  /// Index: task id of a spout; value: index into told_ plus 1, 0: none.
  std::vector<std::uint32_t> place_of_spout_;
  std::size_t told_used_ = 0;
  Told nobody_;
  Told* last_told_ = &nobody_;
  bool wants_flush_ = false;
  std::uint64_t random_;
};

}  // namespace iotcloud::topology::internal
