#include <utility>

#include <iotcloud/topology/endpoints/placement/task_loads.h>

namespace iotcloud::topology {

std::size_t TaskLoads::idlest(UnitKind kind) const {
  std::size_t best = 0;
  for (std::size_t task = 1; task < loads_.size(); ++task) {
    if (std::pair(of(task, kind), total(task)) < std::pair(of(best, kind), total(best))) best = task;
  }
  return best;
}

std::optional<TaskLoads::Move> TaskLoads::next_move() const {
  if (loads_.empty()) return std::nullopt;
  for (const UnitKind kind : {UnitKind::gateway, UnitKind::instance}) {
    std::size_t busiest = 0;
    for (std::size_t task = 1; task < loads_.size(); ++task) {
      if (std::pair(of(task, kind), total(task)) > std::pair(of(busiest, kind), total(busiest))) busiest = task;
    }
    const std::size_t idle = idlest(kind);
    if (of(busiest, kind) > of(idle, kind) + 1) return Move{kind, busiest, idle};
  }
  std::size_t busiest = 0, idle = 0;
  for (std::size_t task = 1; task < loads_.size(); ++task) {
    if (total(task) > total(busiest)) busiest = task;
    if (total(task) < total(idle)) idle = task;
  }
  if (total(busiest) <= total(idle) + 1) return std::nullopt;
  // Tasks differ by one at most in each kind, so the busiest has one more of both kinds than the idlest.
  return Move{UnitKind::instance, busiest, idle};
}

}  // namespace iotcloud::topology
