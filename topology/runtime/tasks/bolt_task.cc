#include <algorithm>
#include <functional>
#include <stdexcept>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>

namespace iotcloud::topology::internal {

BoltTask::BoltTask(const TaskEnvironment& environment, Executors& executors, TopologyContext context,
                   std::unique_ptr<Bolt> bolt, InputPolicies policies, const detail::StreamInfo* tick_stream)
    : Task(environment, executors, std::move(context)),
      bolt_(std::move(bolt)),
      tick_stream_(tick_stream),
      policies_(std::move(policies)),
      mailbox_(*this, environment_.options->mailbox_capacity, policies_.keep_last) {}

BoltTask::~BoltTask() {
  discard();
}

void BoltTask::prepare(const Config& config, EmittingLane& lane) {
  lane_ = &lane;
  const OwnCall own(lane, *this);
  bolt_->prepare(config, context_, *this);
  prepared_ = true;
  lane.flush(*this);
}

void BoltTask::close() {
  if (!std::exchange(prepared_, false)) return;
  guarded("cleanup()", [this] { bolt_->cleanup(); });
}

void BoltTask::fill(TaskSnapshot& snapshot) const {
  snapshot.superseded = mailbox_.superseded();
  snapshot.execute_latency = execute_latency_.summary();
  snapshot.process_latency = process_latency().summary();
}

void BoltTask::collect(std::vector<config::Sample>& samples) const {
  Task::collect(samples);
  add_sample(samples, "iotcloud_task_execute_seconds", "One call of execute()", execute_latency_);
  add_sample(samples, "iotcloud_task_process_seconds", "From execute() to ack or fail", process_latency());
}

void BoltTask::discard() {
  bolt_.reset();
  mailbox_.discard();
  std::vector<std::pair<Answer, Tuple>> answers;  // declared before the lock: tuples are recycled without it
  const config::MutexLock lock(answers_mutex_);
  answers.swap(answers_);
}

// Running.

bool BoltTask::slice(Lane& given) {
  EmittingLane& lane = EmittingLane::of(given);
  lane_ = &lane;
  const OwnCall own(lane, *this);
  const std::uint32_t signals = take_signals();
  if (has_answers_.load(std::memory_order_acquire)) take_answers();
  if ((signals & tick_due) != 0) {
    tick();
    bump(counts_.busy_ns, lane.time_since_last_look());
  }
  const std::int64_t slice_began = lane.now_ns;
  bool more = false;
  while (depth() > 0 && !blocked()) {
    std::size_t taken = 0;
    while (taken < chunk_ && !lane.wants_flush()) {
      TupleCell* cell = mailbox_.next();
      if (cell == nullptr) break;
      execute(Tuple::adopt(cell));
      ++taken;
    }
    const auto took_ns = lane.time_since_last_look();
    if (taken > 0) note_chunk(taken, took_ns);
    lane.flush(*this);
    if (lane.has_ready() || lane.now_ns - slice_began > slice_limit_ns) {
      more = depth() > 0 && !blocked();
      break;
    }
  }
  lane.flush(*this);
  return more;
}

void BoltTask::note_chunk(std::size_t taken, std::uint64_t took_ns) {
  const auto each = static_cast<std::int64_t>(took_ns / taken);
  const std::size_t executed = taken - std::exchange(late_in_chunk_, 0);
  note_each(each);
  bump(counts_.executed, executed);
  bump(counts_.busy_ns, took_ns);
  if (executed > 0) execute_latency_.record_ns(each, executed);
  const std::size_t settled = std::exchange(settled_in_chunk_, 0);
  if (settled > 0 && answers_later_.load(std::memory_order_relaxed)) process_latency_.record_ns(each, settled);
  chunk_ = next_chunk(chunk_, taken, took_ns);
  mailbox_.done(taken);
}

void BoltTask::execute(Tuple tuple) {
  TupleCell* const cell = cell_of(tuple);
  current_ = cell;
  current_settled_ = false;
  if (!policies_.deadlines.empty() && late(*cell)) {
    give_up_late(tuple);
  } else {
    if (taps_.any() && emitter_.is_sink()) taps_.offer(real_ns(), id(), [&] { return tuple; });
    if (!guarded("execute()", [&] { bolt_->execute(tuple); }) && !current_settled_) settle(Answer::fail, tuple);
    if (current_settled_) {
      ++settled_in_chunk_;
    } else if (TrackedDelivery* delivery = cell->tracked() ? cell->open_delivery(this) : nullptr) {
      delivery->executed_ns = lane_->now_ns;
      answers_later_.store(true, std::memory_order_relaxed);
    }
  }
  current_ = nullptr;
}

bool BoltTask::late(const TupleCell& cell) const {
  if (cell.born_ns == 0) return false;
  for (const InputPolicies::Deadline& deadline : policies_.deadlines) {
    if (deadline.stream == cell.stream) return topology_ns() - cell.born_ns > deadline.age_ns;
  }
  return false;
}

void BoltTask::give_up_late(const Tuple& tuple) {
  bump(counts_.late);
  ++late_in_chunk_;
  if (!policies_.late_stream.empty()) {
    guarded("emit to the late stream", [&] {
      do_emit(policies_.late_stream, {&tuple, 1}, Values(tuple.data()->values), no_task);
    });
  }
  settle(Answer::ack, tuple);
}

void BoltTask::tick() {
  TupleCell* cell = TupleCell::make();
  cell->stream = tick_stream_;
  cell->source_task = 0;
  cell->born_ns = 0;
  cell->handles.store(1, std::memory_order_relaxed);
  const Tuple tuple = Tuple::adopt(cell);
  guarded("execute() of a tick", [&] { bolt_->execute(tuple); });
}

// The collector.

void BoltTask::do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) {
  if (!OwnCall::is_of(*this)) {
    throw std::logic_error("component " + context_.component +
                           " emits outside of its own calls; only ack, fail, reset_timeout and report_error may come "
                           "from other threads");
  }
  if (task < no_task) throw std::invalid_argument("there is no task " + std::to_string(task));
  emitter_.choose(stream, values, task);
  bump(counts_.emitted);
  if (taps_.any()) offer_emitted(values, birth_of_child(anchors));
  if (emitter_.chosen() == 0) return;
  bump(counts_.transferred, emitter_.chosen());
  send(anchors, std::move(values));
}

std::int64_t BoltTask::birth_of_child(std::span<const Tuple> anchors) const {
  if (!environment_.has_deadlines) return 0;
  std::int64_t oldest = 0;
  for (const Tuple& anchor : anchors) {
    const std::int64_t born = anchor.data()->born_ns;
    if (born != 0 && (oldest == 0 || born < oldest)) oldest = born;
  }
  if (oldest != 0) return oldest;
  return current_ != nullptr && current_->born_ns != 0 ? current_->born_ns : topology_ns();
}

void BoltTask::send(std::span<const Tuple> anchors, Values&& values) {
  const std::int64_t born = birth_of_child(anchors);
  if (anchors.size() == 1) {
    TupleCell& anchor = *cell_of(anchors.front());
    if (!anchor.tracked()) {
      emitter_.send(*lane_, std::move(values), {}, born);
      return;
    }
    // The children's ids are kept in the anchor's delivery, so that its ack changes the tree once for all of them.
    TrackedDelivery* delivery = anchor.open_delivery(this);
    if (delivery != nullptr && (!anchor.more || anchor.more->trees.empty())) {
      delivery->change ^= emitter_.send(*lane_, std::move(values), {&anchor.tree, 1}, born);
      return;
    }
  }
  roots_.clear();
  for (const Tuple& tuple : anchors) {
    TupleCell& anchor = *cell_of(tuple);
    if (!anchor.tracked() || anchor.open_delivery(this) == nullptr) continue;
    anchor.for_each_tree([&](Tree* tree) { roots_.push_back(tree); });
  }
  // A window's tuples are many, and several may belong to one tree: the ids must change each tree once.
  std::sort(roots_.begin(), roots_.end(), std::less<>());
  roots_.erase(std::unique(roots_.begin(), roots_.end()), roots_.end());
  const std::uint64_t ids = emitter_.send(*lane_, std::move(values), roots_, born);
  // The anchors are not settled, so these trees are still open. Their ids are entered here in time, because no other
  // task gets the new tuple before the lane is flushed.
  for (Tree* tree : roots_) tree->open.fetch_xor(ids, std::memory_order_acq_rel);
}

void BoltTask::ack(const Tuple& tuple) {
  // The usual case: an untracked tuple, acked in its own execute().
  if (OwnCall::is_of(*this) && tuple.data() == current_ && current_ != nullptr && !current_->tracked()) {
    if (std::exchange(current_settled_, true)) return;
    bump(counts_.acked);
    return;
  }
  answer(Answer::ack, tuple);
}

void BoltTask::answer(Answer answer, const Tuple& tuple) {
  if (OwnCall::is_of(*this)) {
    settle(answer, tuple);
    return;
  }
  {
    const config::MutexLock lock(answers_mutex_);
    answers_.emplace_back(answer, tuple);
    has_answers_.store(true, std::memory_order_release);
  }
  environment_.scheduler->schedule(*this);
}

bool BoltTask::is_void(const Tuple& tuple) const {
  if (!tuple || tuple.data()->stream == tick_stream_) return false;
  TupleCell& cell = *cell_of(tuple);
  // A delivery that is not settled keeps its trees.
  if (!cell.tracked() || cell.open_delivery(this) == nullptr) return false;
  bool any = false;
  cell.for_each_tree([&](const Tree* tree) { any = any || (tree->origin && tree->origin->comes_again()); });
  return any;
}

void BoltTask::take_answers() {
  std::vector<std::pair<Answer, Tuple>> answers;
  {
    const config::MutexLock lock(answers_mutex_);
    answers.swap(answers_);
    has_answers_.store(false, std::memory_order_relaxed);
  }
  for (const auto& [answer, tuple] : answers) settle(answer, tuple);
}

void BoltTask::settle(Answer answer, const Tuple& tuple) {
  if (!tuple || tuple.data()->stream == tick_stream_) return;
  TupleCell& cell = *cell_of(tuple);
  TrackedDelivery* delivery = cell.tracked() ? cell.open_delivery(this) : nullptr;
  if (answer == Answer::reset) {
    if (delivery == nullptr) return;
    const std::int64_t now = topology_ns();
    cell.for_each_tree([&](Tree* tree) { tree->touched_ns.store(now, std::memory_order_relaxed); });
    return;
  }
  if (cell.tracked() ? delivery == nullptr : (&cell == current_ && current_settled_)) return;  // it was answered before
  if (&cell == current_) current_settled_ = true;
  bump(answer == Answer::ack ? counts_.acked : counts_.failed);
  if (delivery == nullptr) return;
  if (delivery->executed_ns != 0) process_latency_.record_ns(real_ns() - delivery->executed_ns);
  std::uint8_t flags = 0;
  if (answer == Answer::fail) flags = Tree::failed | Tree::blamed;
  if (answer == Answer::retry) flags = Tree::failed;
  cell.settle(*delivery, flags);
}

}  // namespace iotcloud::topology::internal
