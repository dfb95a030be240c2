#include <random>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>

namespace iotcloud::topology::internal {

namespace {

std::uint64_t new_seed() {
  std::random_device device;
  return (std::uint64_t{device()} << 32) | device();
}

}  // namespace

EmittingLane::EmittingLane(Scheduler& scheduler, std::size_t tasks)
    : Lane(scheduler), out_of_task_(tasks + 1, 0), random_(new_seed()) {}

EmittingLane::Out& EmittingLane::out_to(BoltTask& target) {
  std::uint32_t& slot = out_of_task_[static_cast<std::size_t>(target.id())];
  if (slot == 0) {
    if (outs_used_ == outs_.size()) {
      outs_.emplace_back();
      last_out_ = nullptr;
    }
    Out& out = outs_[outs_used_];
    out.target = &target;
    out.room = target.room();
    slot = static_cast<std::uint32_t>(++outs_used_);
  }
  return outs_[slot - 1];
}

void EmittingLane::flush(Task& emitter) {
  for (std::size_t i = 0; i < outs_used_; ++i) {
    Out& out = outs_[i];
    out_of_task_[static_cast<std::size_t>(out.target->id())] = 0;
    out.target->deliver(out.cells);
    out.cells.clear();
    if (out.target->room() == 0) out.target->block_until_room(emitter);
    scheduler().schedule(*out.target);
  }
  outs_used_ = 0;
  last_out_ = nullptr;
  wants_flush_ = false;
}

}  // namespace iotcloud::topology::internal
