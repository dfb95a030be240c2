#pragma once

#include <cstdint>
#include <span>
#include <utility>

#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>

/// \file
/// What each emit does, to be inlined into the tasks.
namespace iotcloud::topology::internal {

[[gnu::always_inline]] inline TupleCell* Emitter::make_cell(TupleCell::Recycled& recycled, const Stream& stream,
                                                            Values&& values, std::int64_t born_ns) const {
  TupleCell* cell = recycled.take();
  cell->handles.store(1, std::memory_order_relaxed);
  cell->source_task = source_task_;
  cell->stream = stream.out.info;
  cell->born_ns = born_ns;
  cell->values.fill(values);  // a recycled cell has none
  return cell;
}

[[gnu::always_inline]] inline TupleCell* Emitter::send_usual(const Stream& usual, EmittingLane& lane, Values&& values,
                                                             std::int64_t born_ns, Tree* tree, std::uint64_t id) {
  const Receiver target = usual.choose(values);
  TupleCell* cell = make_cell(lane.cells(), usual, std::move(values), born_ns);
  if (tree != nullptr) {
    cell->tree = tree;
    cell->add_delivery(target.task, id);
  }
  lane.put(target, cell);
  return cell;
}

}  // namespace iotcloud::topology::internal
