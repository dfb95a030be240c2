#include <algorithm>
#include <stdexcept>

#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/send.h>

namespace iotcloud::topology::internal {

Receiver Emitter::receiver(int task) const {
  const auto id = static_cast<std::size_t>(task);
  return {(*tasks_)[id], id};
}

void Emitter::set_up(std::vector<OutStream> streams, const std::vector<BoltTask*>* tasks, const Task* self) {
  tasks_ = tasks;
  source_task_ = self->id();
  self_ = self;
  for (OutStream& stream : streams) {
    const std::size_t arity = stream.info->fields.size();
    streams_.push_back({std::move(stream), arity, {}, nullptr, nullptr, tasks->data()});
  }
  for (Stream& stream : streams_) {
    const auto& edges = stream.out.edges;
    if (!stream.out.direct && edges.size() == 1) {
      const Edge& edge = edges.front();
      if (!edge.grouping) {
        stream.only = receiver(edge.targets->front());
      } else if (!edge.custom) {
        stream.grouping = dynamic_cast<detail::ToOneGrouping*>(edge.grouping.get());
      }
      stream.targets = edge.targets->data();
    }
    if (stream.out.info->stream != default_stream) continue;
    default_ = &stream;
    if (!stream.to_one()) continue;
    usual_ = &stream;
    usual_arity_ = stream.arity;
  }
  if (streams_.size() < 2) return;
  // The default stream has what the others do not count, so that a usual emit counts nothing more.
  counts_ = std::make_unique<StreamCounts[]>(streams_.size());
  for (std::size_t i = 0; i < streams_.size(); ++i) {
    if (&streams_[i] != default_) streams_[i].counts = &counts_[i];
  }
}

std::vector<StreamSnapshot> Emitter::counts(std::uint64_t emitted, std::uint64_t transferred) const {
  std::vector<StreamSnapshot> all;
  if (counts_ == nullptr) return all;
  StreamSnapshot others;
  std::size_t rest = streams_.size();
  for (std::size_t i = 0; i < streams_.size(); ++i) {
    const Stream& stream = streams_[i];
    auto& one = all.emplace_back(StreamSnapshot{stream.out.info->stream, 0, 0});
    if (stream.counts == nullptr) {
      rest = i;
      continue;
    }
    one.emitted = stream.counts->emitted.load(std::memory_order_relaxed);
    one.transferred = stream.counts->transferred.load(std::memory_order_relaxed);
    others.emitted += one.emitted;
    others.transferred += one.transferred;
  }
  if (rest < all.size()) {  // the task goes on while its counts are read
    all[rest].emitted = emitted - std::min(emitted, others.emitted);
    all[rest].transferred = transferred - std::min(transferred, others.transferred);
  }
  return all;
}

Emitter::Stream& Emitter::find(std::string_view name) {
  if (is_default(name) && default_ != nullptr) return *default_;
  for (Stream& stream : streams_) {
    if (stream.out.info->stream == name) return stream;
  }
  throw std::invalid_argument("emits to stream \"" + std::string(name) + "\", which it does not declare");
}

void Emitter::choose(std::string_view name, const Values& values, int direct_task) {
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
  chosen_.clear();
  if (stream.to_one()) {
    chosen_.push_back(stream.choose(values));
    return;
  }
  ids_.clear();
  if (out.direct) {
    choose_direct(stream, direct_task);
  } else {
    choose_by_groupings(stream, values);
  }
  for (const int id : ids_) chosen_.push_back(receiver(id));
}

void Emitter::choose_direct(const Stream& stream, int task) {
  for (const Edge& edge : stream.out.edges) {
    if (std::binary_search(edge.targets->begin(), edge.targets->end(), task)) ids_.push_back(task);
  }
  if (ids_.empty()) {
    throw std::invalid_argument("task " + std::to_string(task) + " does not read the direct stream \"" +
                                stream.out.info->stream + "\"");
  }
}

void Emitter::choose_by_groupings(Stream& stream, const Values& values) {
  for (const Edge& edge : stream.out.edges) {
    if (!edge.grouping) {
      ids_.push_back(edge.targets->front());
      continue;
    }
    const std::size_t before = ids_.size();
    edge.grouping->choose(values, ids_);
    if (!edge.custom) continue;
    for (std::size_t i = before; i < ids_.size(); ++i) {
      if (!std::binary_search(edge.targets->begin(), edge.targets->end(), ids_[i])) {
        throw std::invalid_argument("the grouping of stream \"" + stream.out.info->stream + "\" chose task " +
                                    std::to_string(ids_[i]) + ", which does not read it");
      }
    }
  }
}

TupleCell* Emitter::make_cell(TupleCell::Recycled& recycled, Values&& values, std::int64_t born_ns) const {
  return make_cell(recycled, *stream_, std::move(values), born_ns);
}

std::uint64_t Emitter::send(EmittingLane& lane, Values&& values, std::span<Tree* const> trees, std::int64_t born_ns) {
  TupleCell* cell = make_cell(lane.cells(), *stream_, std::move(values), born_ns);
  cell->handles.store(static_cast<std::uint32_t>(chosen_.size()), std::memory_order_relaxed);
  std::uint64_t ids = 0;
  if (!trees.empty()) {
    cell->track(trees);
    for (const Receiver& target : chosen_) {
      const std::uint64_t id = lane.random();
      cell->add_delivery(target.task, id);
      ids ^= id;
    }
    if (self_->watched()) self_->note_emitted(*cell);
  }
  for (const Receiver& target : chosen_) lane.put(target, cell);
  return ids;
}

}  // namespace iotcloud::topology::internal
