#include <algorithm>
#include <stdexcept>

#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>

namespace iotcloud::topology::internal {

void Emitter::set_up(std::vector<OutStream> streams, const std::vector<BoltTask*>* tasks, const Task* self) {
  tasks_ = tasks;
  self_ = self;
  for (OutStream& stream : streams) {
    const std::size_t arity = stream.info->fields.size();
    streams_.push_back({std::move(stream), arity, nullptr});
  }
  for (Stream& stream : streams_) {
    const auto& edges = stream.out.edges;
    if (!stream.out.direct && edges.size() == 1 && !edges.front().grouping) {
      stream.only = (*tasks)[static_cast<std::size_t>(edges.front().targets->front())];
    }
    if (stream.out.info->stream != default_stream) continue;
    default_ = &stream;
    if (stream.only != nullptr) to_one_ = &stream;
  }
}

Emitter::Stream& Emitter::find(std::string_view name) {
  if (name.data() == default_stream && default_ != nullptr) return *default_;
  for (Stream& stream : streams_) {
    if (stream.out.info->stream == name) return stream;
  }
  throw std::invalid_argument("emits to stream \"" + std::string(name) + "\", which it does not declare");
}

void Emitter::choose_among(std::string_view name, const Values& values, int direct_task) {
  Stream& stream = find(name);
  const OutStream& out = stream.out;
  if (stream.arity != values.size()) {
    throw std::invalid_argument("emits " + std::to_string(values.size()) + " values to stream \"" + out.info->stream +
                                "\", whose fields are " + out.info->fields.list());
  }
  if (out.direct != (direct_task >= 0)) {
    throw std::invalid_argument("stream \"" + out.info->stream + "\" is " +
                                (out.direct ? "direct: use emit_direct" : "not declared direct: use emit or emit_to"));
  }
  stream_ = &stream;
  if (stream.only != nullptr) {
    chosen_count_ = 1;
    return;
  }
  chosen_.clear();
  if (out.direct) {
    choose_direct(stream, direct_task);
  } else {
    choose_by_groupings(stream, values);
  }
  chosen_count_ = chosen_.size();
}

void Emitter::choose_direct(const Stream& stream, int task) {
  for (const Edge& edge : stream.out.edges) {
    if (std::binary_search(edge.targets->begin(), edge.targets->end(), task)) chosen_.push_back(task);
  }
  if (chosen_.empty()) {
    throw std::invalid_argument("task " + std::to_string(task) + " does not read the direct stream \"" +
                                stream.out.info->stream + "\"");
  }
}

void Emitter::choose_by_groupings(Stream& stream, const Values& values) {
  for (const Edge& edge : stream.out.edges) {
    if (!edge.grouping) {
      chosen_.push_back(edge.targets->front());
      continue;
    }
    const std::size_t before = chosen_.size();
    edge.grouping->choose(values, chosen_);
    if (!edge.custom) continue;
    for (std::size_t i = before; i < chosen_.size(); ++i) {
      if (!std::binary_search(edge.targets->begin(), edge.targets->end(), chosen_[i])) {
        throw std::invalid_argument("the grouping of stream \"" + stream.out.info->stream + "\" chose task " +
                                    std::to_string(chosen_[i]) + ", which does not read it");
      }
    }
  }
}

TupleCell* Emitter::make_cell(Values&& values, std::int64_t born_ns) const {
  TupleCell* cell = TupleCell::make();
  cell->handles.store(1, std::memory_order_relaxed);
  cell->source_task = self_->id();
  cell->stream = stream_->out.info;
  cell->born_ns = born_ns;
  cell->values = std::move(values);
  return cell;
}

std::uint64_t Emitter::send(EmittingLane& lane, Values&& values, std::span<Tree* const> trees, std::int64_t born_ns) {
  TupleCell* cell = make_cell(std::move(values), born_ns);
  if (!trees.empty()) cell->track(trees);
  const auto delivery_to = [&](BoltTask* task) -> std::uint64_t {
    if (trees.empty()) return 0;
    const std::uint64_t id = lane.random();
    cell->add_delivery(task, id);
    return id;
  };
  if (BoltTask* only = stream_->only) {
    const std::uint64_t id = delivery_to(only);
    lane.put(*only, cell);
    return id;
  }
  cell->handles.store(static_cast<std::uint32_t>(chosen_.size()), std::memory_order_relaxed);
  std::uint64_t ids = 0;
  for (const int target : chosen_) ids ^= delivery_to((*tasks_)[static_cast<std::size_t>(target)]);
  for (const int target : chosen_) lane.put(*(*tasks_)[static_cast<std::size_t>(target)], cell);
  return ids;
}

}  // namespace iotcloud::topology::internal
