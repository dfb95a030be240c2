#pragma once

#include <cstdint>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/lane.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;

/// A lane that also holds what the running task has emitted and not delivered yet. All lanes of a runtime are of this
/// class.
class EmittingLane final : public Lane {
 public:
  /// \param tasks the highest task id.
  EmittingLane(Scheduler& scheduler, std::size_t tasks);
  /// The argument of Runnable::slice() as an EmittingLane, which every lane of a runtime is.
  static EmittingLane& of(Lane& lane) { return static_cast<EmittingLane&>(lane); }

  void put(BoltTask& target, TupleCell* cell) {
    if (last_out_ == nullptr || last_out_->target != &target) last_out_ = &out_to(target);
    auto& cells = last_out_->cells;
    cells.push_back(cell);
    // Other emitters may fill the mailbox at the same time, so this one takes half of the room at most before a flush.
    if (2 * cells.size() >= last_out_->room) wants_flush_ = true;
  }
  /// Delivers everything to the receivers' mailboxes and makes the receivers ready. `emitter` does not run again until
  /// those mailboxes that are full have room.
  void flush(Task& emitter);
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
    BoltTask* target = nullptr;
    std::size_t room = 0;  ///< how many cells fitted into the target's mailbox at the first put()
    std::vector<TupleCell*> cells;
  };
  Out& out_to(BoltTask& target);

  std::vector<std::uint32_t> out_of_task_;  ///< index: task id; value: index into outs_ plus 1, 0: none
  std::vector<Out> outs_;                   ///< never shrinks, to keep the memory of the cells' vectors
  std::size_t outs_used_ = 0;
  Out* last_out_ = nullptr;  ///< receiver of the last put()
  bool wants_flush_ = false;
  std::uint64_t random_;
};

}  // namespace iotcloud::topology::internal
