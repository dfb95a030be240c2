#include <algorithm>
#include <stdexcept>

#include <iotcloud/topology/runtime/bolt_task.h>
#include <iotcloud/topology/runtime/emitter.h>
#include <iotcloud/topology/runtime/lane.h>

namespace iotcloud::topology::internal {

void Emitter::set_up(std::vector<OutStream> streams, const std::vector<BoltTask*>* tasks, const Task* self) {
  streams_ = std::move(streams);
  tasks_ = tasks;
  self_ = self;
}

void Emitter::choose(const std::string& stream, const Values& values, int direct_task) {
  chosen_.clear();
  const auto found =
      std::find_if(streams_.begin(), streams_.end(), [&](const OutStream& s) { return s.info->stream == stream; });
  if (found == streams_.end()) {
    throw std::invalid_argument("emits to stream \"" + stream + "\", which it does not declare");
  }
  if (found->info->fields.size() != values.size()) {
    throw std::invalid_argument("emits " + std::to_string(values.size()) + " values to stream \"" + stream +
                                "\", whose fields are " + found->info->fields.list());
  }
  if (found->direct != (direct_task >= 0)) {
    throw std::invalid_argument(
        "stream \"" + stream + "\" is " +
        (found->direct ? "direct: use emit_direct" : "not declared direct: use emit or emit_to"));
  }
  stream_ = &*found;
  for (Edge& edge : found->edges) {
    if (found->direct) {
      if (std::binary_search(edge.targets.begin(), edge.targets.end(), direct_task)) chosen_.push_back(direct_task);
      continue;
    }
    const std::size_t before = chosen_.size();
    edge.grouping->choose(values, chosen_);
    for (std::size_t i = before; i < chosen_.size(); ++i) {
      if (!std::binary_search(edge.targets.begin(), edge.targets.end(), chosen_[i])) {
        throw std::invalid_argument("the grouping of stream \"" + stream + "\" chose task " +
                                    std::to_string(chosen_[i]) + ", which does not read it");
      }
    }
  }
  if (found->direct && chosen_.empty()) {
    throw std::invalid_argument("task " + std::to_string(direct_task) + " does not read the direct stream \"" + stream +
                                "\"");
  }
}

std::uint64_t Emitter::send(Lane& lane, Values&& values, std::span<Tree* const> trees) {
  TupleCell* cell = TupleCell::make();
  cell->values = std::move(values);
  cell->stream = stream_->info;
  cell->source_task = self_->id();
  cell->handles.store(static_cast<std::uint32_t>(chosen_.size()), std::memory_order_relaxed);
  std::uint64_t ids = 0;
  if (!trees.empty()) {
    cell->trees.assign(trees.begin(), trees.end());
    for (const int target : chosen_) {
      const std::uint64_t id = lane.random();
      ids ^= id;
      cell->add_delivery((*tasks_)[static_cast<std::size_t>(target)], id);
    }
  }
  for (const int target : chosen_) lane.put(*(*tasks_)[static_cast<std::size_t>(target)], cell);
  return ids;
}

}  // namespace iotcloud::topology::internal
