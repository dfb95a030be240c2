#include <algorithm>
#include <random>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/spout_task.h>

namespace iotcloud::topology::internal {

namespace {

constexpr std::size_t first_cells = 16;
constexpr std::size_t many_cells = 8;  ///< a task that gets so many at once has much to do

std::uint64_t new_seed() {
  std::random_device device;
  return (std::uint64_t{device()} << 32) | device();
}

}  // namespace

EmittingLane::EmittingLane(Scheduler& scheduler, std::size_t tasks)
    : Lane(scheduler), out_of_task_(tasks + 1, &nowhere_), place_of_spout_(tasks + 1, 0), random_(new_seed()) {
  nowhere_.end = nowhere_.enough = &first_cell_;
}

void EmittingLane::put_first(BoltTask& target) {
  nowhere_.end = &first_cell_;
  if (outs_used_ == outs_.size()) {
    outs_.push_back(std::make_unique<Out>());
    outs_.back()->cells.reserve(first_cells);
  }
  Out& out = *outs_[outs_used_++];
  out_of_task_[static_cast<std::size_t>(target.id())] = &out;
  out.cells.reserve(first_cells);
  out.target = &target;
  out.room = target.room();
  out.end = out.cells.begin();
  out.enough = out.end + std::min(out.cells.capacity(), (out.room + 1) / 2);
  *out.end++ = first_cell_;
  if (out.end >= out.enough) has_enough(target, out);
}

void EmittingLane::has_enough(BoltTask& target, Out& out) {
  if (&out == &nowhere_) {
    put_first(target);
    return;
  }
  const auto count = static_cast<std::size_t>(out.end - out.cells.begin());
  // Other emitters may fill the mailbox at the same time, so this one takes half of the room at most before a flush.
  if (2 * count >= out.room) wants_flush_ = true;
  if (count == out.cells.capacity()) {
    out.cells.set_size(count);
    out.cells.reserve(2 * count);
  }
  const std::size_t capacity = out.cells.capacity();
  const std::size_t more = wants_flush_ ? capacity : std::min(capacity, (out.room + 1) / 2);
  out.end = out.cells.begin() + count;
  out.enough = out.cells.begin() + more;
}

EmittingLane::Told& EmittingLane::told_to(SpoutTask& owner) {
  std::uint32_t& place = place_of_spout_[static_cast<std::size_t>(owner.id())];
  if (place == 0) {
    if (told_used_ == told_.size()) told_.emplace_back();
    told_[told_used_].owner = &owner;
    place = static_cast<std::uint32_t>(++told_used_);
  }
  return told_[place - 1];
}

void EmittingLane::settle_from_anywhere(TupleCell& cell, detail::Delivery& delivery, std::uint8_t flag) noexcept {
  delivery.executed_ns = detail::Delivery::settled;
  Lane* lane = Lane::of_this_thread();
  cell.for_each_tree([&](Tree* tree) {
    if (lane != nullptr && tree->owner->runs_on(lane->scheduler())) {
      of(*lane).settle(*tree, delivery.change, flag);
    } else {
      FlatList<Settlement> one;
      one.push(Settlement(*tree, delivery.change, flag));
      tree->owner->tell(one);
    }
  });
}

void EmittingLane::deliver(Task& emitter) {
  for (std::size_t i = 0; i < outs_used_; ++i) deliver(emitter, *outs_[i], i == 0);
  outs_used_ = 0;
  wants_flush_ = false;
}

void EmittingLane::deliver(Task& emitter, Out& out, bool first) {
  BoltTask& target = *out.target;
  out_of_task_[static_cast<std::size_t>(target.id())] = &nowhere_;
  out.cells.set_size(static_cast<std::size_t>(out.end - out.cells.begin()));
  const bool many = out.cells.size() >= many_cells;
  if (scheduler().take(target)) {
    target.hand(out.cells);
    if (target.room() == 0) target.block_until_room(emitter);
    scheduler().run_taken(target, first, many);
  } else {
    target.deliver({out.cells.begin(), out.cells.end()});
    if (target.room() == 0) target.block_until_room(emitter);
    scheduler().schedule(target, many);
  }
}

void EmittingLane::tell() {
  for (std::size_t i = 0; i < told_used_; ++i) {
    Told& told = told_[i];
    place_of_spout_[static_cast<std::size_t>(told.owner->id())] = 0;
    told.owner->tell(told.settlements);
  }
  told_used_ = 0;
  last_told_ = &nobody_;
}

}  // namespace iotcloud::topology::internal
