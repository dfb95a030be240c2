#include <algorithm>
#include <functional>
#include <stdexcept>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/send.h>

namespace iotcloud::topology::internal {

BoltTask::BoltTask(const TaskEnvironment& environment, Executors& executors, TopologyContext context,
                   std::unique_ptr<Bolt> bolt, const std::vector<const detail::StreamInfo*>& inputs,
                   InputPolicies policies, const detail::StreamInfo* tick_stream)
    : Task(environment, executors, Role::worker, std::move(context)),
      bolt_(std::move(bolt)),
      tick_stream_(tick_stream),
      policies_(std::move(policies)),
      inputs_(inputs.size() > 1 ? inputs.size() : 0),
      mailbox_(*this, environment_.options->mailbox_capacity, policies_.keep_last) {
  for (std::size_t i = 0; i < inputs_.size(); ++i) inputs_[i].stream = inputs[i];
}

BoltTask::~BoltTask() {
  discard();
}

void BoltTask::prepare(const Config& config, EmittingLane& lane) {
  lane_ = &lane;
  lane.begin();
  const OwnCall own(lane, *this);
  bolt_->prepare(config, context_, *this);
  prepared_ = true;
  count_usual();
  lane.flush(*this);
}

void BoltTask::close() {
  if (!std::exchange(prepared_, false)) return;
  guarded("cleanup()", [this] { bolt_->cleanup(); });
}

void BoltTask::fill(TaskSnapshot& snapshot) const {
  for (const InputCounts& input : inputs_) {
    snapshot.inputs.push_back(
        {input.stream->component, input.stream->stream, input.executed.load(std::memory_order_relaxed),
         input.acked.load(std::memory_order_relaxed), input.failed.load(std::memory_order_relaxed),
         input.late.load(std::memory_order_relaxed)});
  }
  snapshot.superseded = mailbox_.superseded();
  snapshot.execute_latency = execute_latency_.summary();
  snapshot.process_latency = process_latency().summary();
  snapshot.execute_spread = execute_latency_.spread();
  snapshot.process_spread = process_latency().spread();
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

namespace {

/// A handle without a destructor: who executes the tuple lets go of it, because it knows the cell's class.
union Lent {
  explicit Lent(TupleCell& cell) : tuple(Tuple::adopt(&cell)) {}
  ~Lent() {}  // NOLINT(modernize-use-equals-default): that one would be deleted
  Lent(const Lent&) = delete;
  Lent& operator=(const Lent&) = delete;
  Tuple tuple;
};

}  // namespace

/// Executes tuples until one of them fills a mailbox. \return how many. \tparam plain no deadlines, and no taps.
/// \tparam several false: there is one input, so that nothing is counted by input.
template <bool plain, bool several>
[[gnu::noinline]] std::size_t BoltTask::execute_some(std::span<TupleCell* const> cells) {
  constexpr std::ptrdiff_t ahead = 4;
  EmittingLane& lane = *lane_;
  TupleCell* const* const begin = cells.data();
  TupleCell* const* const end = begin + cells.size();
  TupleCell* const* at = begin;
  [[maybe_unused]] InputCounts* input = nullptr;
  for (; at != end && !lane.wants_flush(); ++at) {
    if (end - at > ahead) {
      const auto* soon = reinterpret_cast<const char*>(at[ahead]);
      __builtin_prefetch(soon, 1);
      __builtin_prefetch(soon + 64, 1);
    }
    TupleCell* const cell = *at;
    const Lent lent(*cell);
    const Tuple& tuple = lent.tuple;
    current_ = open_ = cell;
    if constexpr (several) {
      if (input == nullptr || input->stream != cell->stream) input = find_input(cell->stream);
    }
    [[maybe_unused]] const std::size_t acked_before = acked_in_chunk_;
    bool given_up = false;
    std::int64_t watched_ns = 0;
    if constexpr (!plain) {
      given_up = !policies_.deadlines.empty() && late(*cell);
      if (given_up) {
        give_up_late(tuple);
      } else if (taps_.any()) {
        watched_ns = begin_watched(tuple);
      }
    }
    if (!given_up) {
      if (!guarded("execute()", [&] { bolt_->execute(tuple); }) && open_ != nullptr) settle(Answer::fail, tuple);
      if (open_ != nullptr) leave_open(*cell);
      if (watched_ns != 0) note_executed(*cell, watched_ns);
    }
    if constexpr (several) {
      if (input != nullptr) {
        bump(given_up ? input->late : input->executed);
        bump(input->acked, acked_in_chunk_ - acked_before);  // settle() counts the other acks
      }
    }
    if (cell->let_go()) cell->recycle(lane.cells());
  }
  current_ = open_ = nullptr;
  return static_cast<std::size_t>(at - begin);
}

/// \return null: the task has one input, or the tuple is none of its inputs.
InputCounts* BoltTask::find_input(const detail::StreamInfo* stream) {
  const auto input = std::find_if(inputs_.begin(), inputs_.end(), [&](const auto& i) { return i.stream == stream; });
  return input == inputs_.end() ? nullptr : &*input;
}

/// Gives the first child an id of its own, as the others have: the tuple is not acked in its own execute().
void BoltTask::disinherit(TupleCell& parent) {
  if (heir_ == nullptr) return;
  const std::uint64_t id = lane_->random();
  std::exchange(heir_, nullptr)->first.change = id;
  parent.first.change ^= id;
}

/// The bolt keeps the tuple, and answers later.
void BoltTask::leave_open(TupleCell& cell) {
  ++left_in_chunk_;
  disinherit(cell);
  detail::Delivery* delivery = cell.tracked() ? cell.open_delivery(this) : nullptr;
  if (delivery == nullptr) return;
  delivery->executed_ns = lane_->now_ns;
  answers_later_.store(true, std::memory_order_relaxed);
}

/// \return how many tuples were taken from the mailbox.
std::size_t BoltTask::execute_chunk() {
  const bool plain = policies_.deadlines.empty() && !taps_.any();
  std::size_t taken = 0;
  while (taken < chunk_ && !lane_->wants_flush()) {
    std::span<TupleCell* const> cells = mailbox_.next();
    if (cells.empty()) break;
    cells = cells.first(std::min(cells.size(), chunk_ - taken));
    const std::size_t some = !plain            ? execute_some<false, true>(cells)
                             : inputs_.empty() ? execute_some<true, false>(cells)
                                               : execute_some<true, true>(cells);
    mailbox_.took(some);
    taken += some;
  }
  return taken;
}

/// Shows a tuple that is about to be executed to the taps. \return the time at which its execution begins
std::int64_t BoltTask::begin_watched(const Tuple& tuple) {
  if (emitter_.is_sink()) taps_.offer(real_ns(), id(), [&] { return tuple; });
  return topology_ns();
}

void BoltTask::note_executed(const TupleCell& cell, std::int64_t begin_ns) const {
  const std::int64_t now = topology_ns();
  for_each_trace(cell, [&](TupleTrace& trace) {
    if (open_ == nullptr) trace.settled(context_, cell, now, true);  // of a tuple that failed, settle() has told it
    trace.executed(context_, cell, begin_ns, now);
  });
}

bool BoltTask::slice(Lane& given) {
  EmittingLane& lane = EmittingLane::of(given);
  lane_ = &lane;
  lane.begin();
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
    const std::size_t taken = execute_chunk();
    const auto took_ns = lane.time_since_last_look();
    if (taken > 0) note_chunk(taken, took_ns);
    lane.flush(*this);
    if (lane.has_ready() || lane.now_ns - slice_began > slice_limit_ns) {
      more = depth() > 0 && !blocked();
      break;
    }
  }
  count_usual();
  lane.flush(*this);
  return more;
}

void BoltTask::note_chunk(std::size_t taken, std::uint64_t took_ns) {
  const auto each = static_cast<std::int64_t>(took_ns / taken);
  const std::size_t executed = taken - std::exchange(late_in_chunk_, 0);
  const std::size_t answered = executed - std::exchange(left_in_chunk_, 0);
  note(each_ns_, each);
  note(each_handled_ns_, static_cast<std::int64_t>(took_ns / (taken + usual_emits_)));
  count_usual();
  bump(counts_.executed, executed);
  bump(counts_.acked, std::exchange(acked_in_chunk_, 0));
  bump(counts_.busy_ns, took_ns);
  if (executed > 0) execute_latency_.record_ns(each, executed);
  if (answered > 0 && answers_later_.load(std::memory_order_relaxed)) process_latency_.record_ns(each, answered);
  chunk_ = next_chunk(chunk_, taken, took_ns);
  mailbox_.done(taken);
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
  TupleCell* cell = lane_->cells().take();
  cell->stream = tick_stream_;
  cell->source_task = 0;
  cell->born_ns = 0;
  cell->handles.store(1, std::memory_order_relaxed);
  const Tuple tuple = Tuple::adopt(cell);
  guarded("execute() of a tick", [&] { bolt_->execute(tuple); });
}

// The collector.

void BoltTask::do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) {
  // The usual case: there is one anchor, from which the tuple has its birth, if births are recorded; nobody watches.
  const Emitter::Stream* usual = emitter_.usual(stream, values, task);
  if (usual != nullptr && anchors.size() == 1 && OwnCall::is_of(*this) && !taps_.any()) {
    TupleCell& anchor = *cell_of(anchors.front());
    const std::int64_t born = anchor.born_ns;
    if (born == 0 && environment_.births) return emit_any(stream, anchors, std::move(values), task);  // a tick
    if (!anchor.tracked()) {
      ++usual_emits_;
      emitter_.send_usual(*usual, *lane_, std::move(values), born, nullptr, 0);
      return;
    }
    if (anchor.more == nullptr && anchor.first.is_open_for(this)) {
      ++usual_emits_;
      if (heir_ == nullptr && &anchor == open_) {
        heir_ = emitter_.send_usual(*usual, *lane_, std::move(values), born, anchor.tree, 0);
        return;
      }
      const std::uint64_t id = lane_->random();
      emitter_.send_usual(*usual, *lane_, std::move(values), born, anchor.tree, id);
      anchor.first.change ^= id;
      return;
    }
  }
  emit_any(stream, anchors, std::move(values), task);
}

void BoltTask::emit_any(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) {
  if (!OwnCall::is_of(*this)) {
    throw std::logic_error("component " + context_.component +
                           " emits outside of its own calls; only ack, fail, reset_timeout and report_error may come "
                           "from other threads");
  }
  if (task < no_task) throw std::invalid_argument("there is no task " + std::to_string(task));
  emitter_.choose(stream, values, task);
  bump(counts_.emitted);
  emitter_.count_for_stream();
  const std::int64_t born = environment_.births ? birth_of_child(anchors) : 0;
  if (taps_.any()) offer_emitted(values, born);
  if (emitter_.chosen() == 0) return;
  bump(counts_.transferred, emitter_.chosen());
  send(anchors, std::move(values), born);
}

std::int64_t BoltTask::birth_of_child(std::span<const Tuple> anchors) const {
  std::int64_t oldest = 0;
  for (const Tuple& anchor : anchors) {
    const std::int64_t born = anchor.data()->born_ns;
    if (born != 0 && (oldest == 0 || born < oldest)) oldest = born;
  }
  if (oldest != 0) return oldest;
  return current_ != nullptr && current_->born_ns != 0 ? current_->born_ns : topology_ns();
}

void BoltTask::send(std::span<const Tuple> anchors, Values&& values, std::int64_t born) {
  if (anchors.size() == 1) {
    TupleCell& anchor = *cell_of(anchors.front());
    if (!anchor.tracked()) {
      emitter_.send(*lane_, std::move(values), {}, born);
      return;
    }
    // The children's ids are kept in the anchor's delivery, so that its ack changes the tree once for all of them.
    detail::Delivery* delivery = anchor.open_delivery(this);
    if (delivery != nullptr && anchor.has_one_tree()) {
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
  // The trees stay open until their task knows the ids, because it hears of the anchors' settlement later.
  for (Tree* tree : roots_) lane_->settle(*tree, ids, 0);
}

void BoltTask::ack(const Tuple& tuple) {
  // The usual case: acked in its own execute(), and no other task has received it.
  if (OwnCall::is_of(*this) && open_ != nullptr && tuple.data() == open_) [[likely]] {
    TupleCell& cell = *open_;
    if (!cell.tracked()) {
      open_ = nullptr;
      ++acked_in_chunk_;
      return;
    }
    if (cell.more == nullptr && cell.first.is_open_for(this)) [[likely]] {
      if (heir_ != nullptr) {
        open_ = nullptr;
        ++acked_in_chunk_;
        cell.first.executed_ns = detail::Delivery::settled;
        std::exchange(heir_, nullptr)->first.change = cell.first.change;
        return;
      }
      if (lane_->settles_at_once(*cell.tree)) [[likely]] {
        open_ = nullptr;
        ++acked_in_chunk_;
        cell.first.executed_ns = detail::Delivery::settled;
        lane_->settle(*cell.tree, cell.first.change, 0);
        return;
      }
    }
  }
  answer(Answer::ack, tuple);  // at the end, as no other function is called: so the usual case needs few registers
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
  cell.for_each_tree([&](const Tree* tree) { any = any || (tree->has_origin && tree->origin->comes_again()); });
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
  detail::Delivery* delivery = cell.tracked() ? cell.open_delivery(this) : nullptr;
  if (answer == Answer::reset) {
    if (delivery == nullptr) return;
    const std::int64_t now = topology_ns();
    cell.for_each_tree([&](Tree* tree) { tree->touched_ns.store(now, std::memory_order_relaxed); });
    return;
  }
  if (cell.tracked() ? delivery == nullptr : (&cell == current_ && open_ == nullptr)) return;  // it was answered before
  if (&cell == current_) {
    open_ = nullptr;
    disinherit(cell);
  }
  bump(answer == Answer::ack ? counts_.acked : counts_.failed);
  if (InputCounts* const input = find_input(cell.stream)) bump(answer == Answer::ack ? input->acked : input->failed);
  if (delivery == nullptr) return;
  if (delivery->executed_ns != 0) process_latency_.record_ns(real_ns() - delivery->executed_ns);
  if (taps_.any() && (&cell != current_ || answer != Answer::ack)) {
    const std::int64_t now = topology_ns();
    for_each_trace(cell, [&](TupleTrace& trace) { trace.settled(context_, cell, now, answer == Answer::ack); });
  }
  std::uint8_t flags = 0;
  if (answer == Answer::fail) flags = Tree::failed | Tree::blamed;
  if (answer == Answer::retry) flags = Tree::failed;
  lane_->settle(cell, *delivery, flags);
}

}  // namespace iotcloud::topology::internal
