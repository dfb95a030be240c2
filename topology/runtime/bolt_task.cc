#include <algorithm>
#include <stdexcept>

#include <iotcloud/topology/runtime/bolt_task.h>
#include <iotcloud/topology/runtime/scheduler.h>
#include <iotcloud/topology/runtime/slice_clock.h>

namespace iotcloud::topology::internal {

BoltTask::BoltTask(const Surroundings& surroundings, TopologyContext context, std::unique_ptr<Bolt> bolt,
                   const detail::StreamInfo* tick_stream)
    : Task(surroundings, std::move(context)),
      bolt_(std::move(bolt)),
      tick_stream_(tick_stream),
      capacity_(std::max<std::size_t>(around_.options->mailbox_capacity, 2)),
      execute_latency_(&context_.metrics->histogram("iotcloud_task_execute_seconds", "One call of execute()",
                                                    {{"topology", context_.topology},
                                                     {"component", context_.component},
                                                     {"task", std::to_string(context_.task)}})) {}

BoltTask::~BoltTask() {
  discard();
}

void BoltTask::prepare(const Config& config, Lane& lane) {
  lane_ = &lane;
  const OwnCall own(lane, *this);
  bolt_->prepare(config, context_, *this);
  prepared_ = true;
  lane.flush(*this);
}

void BoltTask::close() {
  if (!prepared_) return;
  guarded("cleanup()", [this] { bolt_->cleanup(); });
  publish_counts();
}

void BoltTask::fill(TaskSnapshot& snapshot) const {
  snapshot.execute_latency = execute_latency_->summary();
}

void BoltTask::discard() {
  const auto drop = [](std::vector<TupleCell*>& cells, std::size_t from) {
    for (std::size_t i = from; i < cells.size(); ++i) Tuple::adopt(cells[i]);
    cells.clear();
  };
  bolt_.reset();
  drop(batch_, next_);
  next_ = 0;
  drop(waiting_, 0);
  answers_.clear();
}

// The mailbox.

void BoltTask::deliver(std::span<TupleCell* const> cells) {
  const std::lock_guard lock(mutex_);
  waiting_.insert(waiting_.end(), cells.begin(), cells.end());
  depth_.fetch_add(cells.size());
}

bool BoltTask::block_until_room(Task& emitter) {
  const std::lock_guard lock(mutex_);
  if (std::find(blocked_.begin(), blocked_.end(), &emitter) != blocked_.end()) return true;
  // Announced first, looked at the depth second; done() does it the other way round, so one of the two sees the other.
  has_blocked_.store(true);
  if (depth_.load() <= capacity_ / 2) {
    has_blocked_.store(!blocked_.empty());
    return false;
  }
  blocked_.push_back(&emitter);
  emitter.block();
  return true;
}

void BoltTask::done(std::size_t executed) {
  const std::size_t left = depth_.fetch_sub(executed) - executed;
  if (left > capacity_ / 2 || !has_blocked_.load()) return;
  std::vector<Task*> freed;
  {
    const std::lock_guard lock(mutex_);
    freed.swap(blocked_);
    has_blocked_.store(false);
  }
  for (Task* emitter : freed) emitter->unblock();
}

bool BoltTask::refill() {
  batch_.clear();
  next_ = 0;
  const std::lock_guard lock(mutex_);
  batch_.swap(waiting_);
  return !batch_.empty();
}

// Running.

bool BoltTask::slice(Lane& lane) {
  lane_ = &lane;
  const OwnCall own(lane, *this);
  const std::uint32_t signals = take_signals();
  if (has_answers_.load(std::memory_order_acquire)) take_answers();
  if ((signals & tick_due) != 0) tick();
  const std::int64_t slice_began = real_ns();
  std::int64_t began = slice_began;
  bool more = false;
  while (depth() > 0 && !blocked()) {
    std::size_t executed = 0;
    while (executed < chunk_ && !lane.wants_flush() && (next_ < batch_.size() || refill())) {
      execute(Tuple::adopt(batch_[next_++]));
      ++executed;
    }
    const std::int64_t now = real_ns();
    if (executed > 0) {
      bump(counts_.executed, executed);
      execute_latency_->record_ns((now - began) / static_cast<std::int64_t>(executed), executed);
      chunk_ = next_chunk(chunk_, executed, now - began);
      done(executed);
    }
    lane.flush(*this);
    began = now;
    if (lane.has_ready() || now - slice_began > slice_limit_ns) {
      more = depth() > 0 && !blocked();
      break;
    }
  }
  lane.flush(*this);
  publish_counts();
  return more;
}

void BoltTask::execute(Tuple tuple) {
  current_ = cell_of(tuple);
  current_settled_ = false;
  if (!guarded("execute()", [&] { bolt_->execute(tuple); }) && !current_settled_) settle(Answer::fail, tuple);
  current_ = nullptr;
}

void BoltTask::tick() {
  TupleCell* cell = TupleCell::make();
  cell->stream = tick_stream_;
  cell->source_task = 0;
  cell->handles.store(1, std::memory_order_relaxed);
  const Tuple tuple = Tuple::adopt(cell);
  guarded("execute() of a tick", [&] { bolt_->execute(tuple); });
}

// The collector.

void BoltTask::emit_to(const std::string& stream, std::span<const Tuple> anchors, Values values) {
  emit(-1, stream, anchors, std::move(values));
}

void BoltTask::emit_direct(int task, const std::string& stream, std::span<const Tuple> anchors, Values values) {
  if (task < 0) throw std::invalid_argument("there is no task " + std::to_string(task));
  emit(task, stream, anchors, std::move(values));
}

void BoltTask::emit(int direct_task, const std::string& stream, std::span<const Tuple> anchors, Values&& values) {
  if (!OwnCall::is_of(*this)) {
    throw std::logic_error("component " + context_.component +
                           " emits outside of its own calls; only ack, fail, reset_timeout and report_error may come "
                           "from other threads");
  }
  emitter_.choose(stream, values, direct_task);
  bump(counts_.emitted);
  if (emitter_.chosen() == 0) return;
  bump(counts_.transferred, emitter_.chosen());

  if (anchors.size() == 1) {
    // The children's ids wait in the anchor's delivery, so that its ack changes the tree once for all of them.
    TupleCell& anchor = *cell_of(anchors.front());
    if (Delivery* delivery = anchor.tracked() ? anchor.open_delivery(this) : nullptr) {
      delivery->change ^= emitter_.send(*lane_, std::move(values), anchor.trees);
      return;
    }
  }
  roots_.clear();
  for (const Tuple& tuple : anchors) {
    TupleCell& anchor = *cell_of(tuple);
    if (!anchor.tracked() || anchor.open_delivery(this) == nullptr) continue;
    for (Tree* tree : anchor.trees) {
      if (std::find(roots_.begin(), roots_.end(), tree) == roots_.end()) roots_.push_back(tree);
    }
  }
  const std::uint64_t ids = emitter_.send(*lane_, std::move(values), roots_);
  // The anchors are open, so these trees are; nobody has seen the new tuple before the lane is flushed.
  for (Tree* tree : roots_) tree->open.fetch_xor(ids, std::memory_order_acq_rel);
}

void BoltTask::answer(Answer answer, const Tuple& tuple) {
  if (OwnCall::is_of(*this)) {
    settle(answer, tuple);
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    answers_.emplace_back(answer, tuple);
    has_answers_.store(true, std::memory_order_release);
  }
  around_.scheduler->schedule(*this);
}

void BoltTask::take_answers() {
  std::vector<std::pair<Answer, Tuple>> answers;
  {
    const std::lock_guard lock(mutex_);
    answers.swap(answers_);
    has_answers_.store(false, std::memory_order_relaxed);
  }
  for (const auto& [answer, tuple] : answers) settle(answer, tuple);
}

void BoltTask::settle(Answer answer, const Tuple& tuple) {
  if (!tuple || tuple.data()->stream == tick_stream_) return;
  TupleCell& cell = *cell_of(tuple);
  Delivery* delivery = cell.tracked() ? cell.open_delivery(this) : nullptr;
  if (answer == Answer::reset) {
    if (delivery == nullptr) return;
    const std::int64_t now = around_.clock->now().time_since_epoch().count();
    for (Tree* tree : cell.trees) tree->touched_ns.store(now, std::memory_order_relaxed);
    return;
  }
  if (cell.tracked() ? delivery == nullptr : (&cell == current_ && current_settled_)) return;  // a second time
  if (&cell == current_) current_settled_ = true;
  bump(answer == Answer::ack ? counts_.acked : counts_.failed);
  if (delivery != nullptr) cell.settle(*delivery, answer == Answer::fail ? Tree::failed : std::uint8_t{0});
}

}  // namespace iotcloud::topology::internal
