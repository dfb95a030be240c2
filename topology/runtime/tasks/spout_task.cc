#include <algorithm>
#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/topology/runtime/logger.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/send.h>
#include <iotcloud/topology/runtime/tasks/spout_task.h>

namespace iotcloud::topology::internal {

namespace {
/// A spout whose next_tuple() threw is asked again after this pause.
constexpr std::chrono::milliseconds pause_after_throw{100};

/// One line of the log names all trees that failed in this time, and another one follows not before `between_lines`.
constexpr std::chrono::nanoseconds gathering_failures = std::chrono::seconds(1);
constexpr std::chrono::nanoseconds between_lines = std::chrono::seconds(60);

constexpr std::size_t many_settlements = 8;  ///< a spout that is told so many at once has much to do
}  // namespace

void WakeGate::wake() noexcept {
  if ((users_.fetch_add(1, std::memory_order_acq_rel) & shut_bit) == 0 && task_ != nullptr) task_->wake();
  if (users_.fetch_sub(1, std::memory_order_acq_rel) == (shut_bit | 1)) users_.notify_all();
}

void WakeGate::shut() noexcept {
  users_.fetch_or(shut_bit, std::memory_order_acq_rel);
  for (std::uint32_t users = users_.load(); users != shut_bit; users = users_.load()) users_.wait(users);
}

SpoutTask::SpoutTask(const TaskEnvironment& environment, Executors& executors, TopologyContext context,
                     std::unique_ptr<Spout> spout, std::shared_ptr<WakeGate> gate, std::size_t max_pending)
    : Task(environment, executors, Role::source, std::move(context)),
      spout_(std::move(spout)),
      gate_(std::move(gate)),
      max_pending_(max_pending) {}

SpoutTask::~SpoutTask() {
  {
    // Only settlements lead to the trees of whose end the spout was told.
    const config::MutexLock lock(settlements_mutex_);
    for (const Settlement& settlement : settlements_) {
      Tree& tree = *settlement.tree;
      tree.open ^= settlement.change;
      if (tree.ended && tree.open == 0) tree.recycle();
    }
  }
  for (Tree* tree : wheel_) {
    while (tree != nullptr) {
      Tree* older = tree->older;
      tree->recycle();
      tree = older;
    }
  }
}

void SpoutTask::open(const Config& config, EmittingLane& lane) {
  lane_ = &lane;
  lane.begin();
  gate_->open(*this);
  now_ns_ = topology_ns();
  const OwnCall own(lane, *this);
  spout_->open(config, context_, *this);
  opened_ = true;
  count_usual();
  lane.flush(*this);
}

void SpoutTask::close() {
  if (!std::exchange(opened_, false)) return;
  tell_failures();
  if (std::exchange(active_, false)) guarded("deactivate()", [this] { spout_->deactivate(); });
  guarded("close()", [this] { spout_->close(); });
}

void SpoutTask::fill(TaskSnapshot& snapshot) const {
  snapshot.pending = pending_.load(std::memory_order_relaxed);
  const std::int64_t oldest = oldest_ns_.load(std::memory_order_relaxed);
  constexpr double nanoseconds = 1e9;
  if (oldest != 0)
    snapshot.oldest_seconds = static_cast<double>(std::max<std::int64_t>(0, topology_ns() - oldest)) / nanoseconds;
  snapshot.complete_latency = complete_latency_.summary();
  snapshot.complete_spread = complete_latency_.spread();
}

void SpoutTask::collect(std::vector<config::Sample>& samples) const {
  Task::collect(samples);
  add_sample(samples, "iotcloud_spout_complete_seconds", "From emit to the ack of the whole tree", complete_latency_);
}

void SpoutTask::wake() noexcept {
  woken_.store(true, std::memory_order_release);
  // A task that may not emit now runs when that changes; this thread would only take it away from those that work for
  // it. The fence is before full() looks here, and between a change of that and reading woken_ in ask(): so either this
  // thread sees the change, or ask() sees woken_.
  std::atomic_thread_fence(std::memory_order_seq_cst);
  if (full()) return;
  environment_.scheduler->run_now(*this);
}

void SpoutTask::set_active(bool active) {
  wanted_active_.store(active, std::memory_order_release);
  signal(activity_due);
}

// Running.

bool SpoutTask::slice(Lane& given) {
  EmittingLane& lane = EmittingLane::of(given);
  lane_ = &lane;
  lane.begin();
  const OwnCall own(lane, *this);
  now_ns_ = environment_.clock_is_real ? lane.now_ns : topology_ns();
  const std::uint32_t signals = take_signals();
  if ((signals & activity_due) != 0) switch_activity();
  if ((signals & poll_due) != 0) poll_armed_ = false;
  if ((signals & failures_due) != 0) tell_failures();
  take_settlements();  // before the time-outs: what was acked in time is acked
  if (wheel_armed_) turn_wheel();
  const bool more = may_have_more(signals) && ask(lane);
  count_usual();
  lane.flush(*this);
  note_oldest();
  return more;
}

void SpoutTask::switch_activity() {
  const bool wanted = wanted_active_.load(std::memory_order_acquire);
  if (wanted == active_) return;
  active_ = wanted;
  if (wanted) {
    guarded("activate()", [this] { spout_->activate(); });
  } else {
    guarded("deactivate()", [this] { spout_->deactivate(); });
  }
}

/// Tells the spout when back pressure begins or ends.
bool SpoutTask::decide_to_ask() {
  if (!active_) return false;
  const bool now_full = full();
  if (now_full != throttled_) {
    throttled_ = now_full;
    guarded("throttled()", [&] { spout_->throttled(now_full); });
  }
  return !now_full;
}

/// \return true when the spout is to be asked again soon.
bool SpoutTask::ask(EmittingLane& lane) {
  const std::int64_t slice_began = lane.now_ns;
  while (may_ask()) {
    std::atomic_thread_fence(std::memory_order_seq_cst);  // see wake()
    woken_.exchange(false, std::memory_order_acquire);    // with what the waking thread wrote before
    bool more = true;
    std::chrono::microseconds pause{0};
    std::size_t calls = 0, executed = 0;
    for (; more && calls < chunk_ && !lane.wants_flush() && (calls == 0 || may_ask()); ++calls) {
      if (environment_.births) asked_ns_ = environment_.clock_is_real ? real_ns() : topology_ns();
      if (!guarded("next_tuple()", [&] { more = spout_->next_tuple(); })) {
        more = false;
        pause = pause_after_throw;
      }
      asked_ns_ = 0;
      if (more) ++executed;
      if (!acked_at_once_.empty()) take_acked_at_once();
    }
    bump(counts_.executed, executed);
    count_usual();
    lane.flush(*this);
    const std::uint64_t took_ns = lane.time_since_last_look();
    now_ns_ = environment_.clock_is_real ? lane.now_ns : topology_ns();
    bump(counts_.busy_ns, took_ns);
    chunk_ = next_chunk(chunk_, calls, took_ns);
    dry_ = !more;
    if (!more && !woken_.load(std::memory_order_acquire)) {
      if (pause.count() == 0) pause = spout_->poll_period();  // asked after next_tuple(), which may change it
      if (pause.count() > 0 && !poll_armed_) {
        poll_armed_ = true;
        environment_.timers->add(environment_.clock->now() + pause, *this, poll_due);
      }
      return false;
    }
    if (lane.has_ready() || lane.now_ns - slice_began > slice_limit_ns) return true;
    take_settlements();
  }
  return false;
}

// Trees in the wheel.

inline void SpoutTask::link(Tree& tree, std::size_t slot) {
  tree.slot = static_cast<std::uint8_t>(slot);
  tree.newer = nullptr;
  tree.older = wheel_[slot];
  (tree.older != nullptr ? tree.older->newer : tails_[slot]) = &tree;
  wheel_[slot] = &tree;
}

inline void SpoutTask::unlink(Tree& tree) {
  (tree.newer != nullptr ? tree.newer->older : wheel_[tree.slot]) = tree.older;
  (tree.older != nullptr ? tree.older->newer : tails_[tree.slot]) = tree.newer;
}

inline void SpoutTask::track(Tree& tree) {
  bump(pending_);
  if (!wheel_armed_) {
    slot_ends_ns_ = tree.emitted_ns + slot_width_ns();
    arm_wheel();
  }
  link(tree, slot_);
}

// The collector.

/// \return null if nothing is tracked.
[[gnu::always_inline]] inline Tree* SpoutTask::make_tree(MessageId id) {
  if (!environment_.options->acking) return nullptr;
  Tree* tree = Tree::make(lane_->trees(), *this, id, now_ns_);
  if (origin_) tree->set_origin(std::move(origin_));
  return tree;
}

/// Of a tuple that the spout emits now; 0: births are not recorded.
inline std::int64_t SpoutTask::birth() const {
  return asked_ns_ == 0 && environment_.births ? topology_ns() : asked_ns_;
}

void SpoutTask::do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) {
  // The usual case: nobody watches.
  const Emitter::Stream* usual = emitter_.usual(stream, values, task);
  if (usual == nullptr || !OwnCall::is_of(*this) || taps_.any()) return emit_any(stream, std::move(values), task, id);
  ++usual_emits_;
  const std::int64_t born = birth();
  Tree* const tree = id != nullptr ? make_tree(*id) : nullptr;
  emitter_.send_usual(*usual, *lane_, std::move(values), born, tree, Tree::only_root);
  if (tree != nullptr) {
    tree->open = Tree::only_root;
    track(*tree);
  } else if (id != nullptr) {
    acked_at_once_.push_back(*id);
  }
}

void SpoutTask::emit_any(std::string_view stream, Values&& values, int task, const MessageId* id) {
  if (!OwnCall::is_of(*this)) {
    throw std::logic_error("component " + context_.component + " emits outside of its own calls");
  }
  if (task < no_task) throw std::invalid_argument("there is no task " + std::to_string(task));
  emitter_.choose(stream, values, task);
  bump(counts_.emitted);
  bump(counts_.transferred, emitter_.chosen());
  emitter_.count_for_stream();
  const std::int64_t born = birth();
  if (taps_.any()) offer_emitted(values, born);
  if (emitter_.chosen() > 0) {
    if (Tree* tree = id != nullptr ? make_tree(*id) : nullptr) {
      tree->open = emitter_.send(*lane_, std::move(values), {&tree, 1}, born);
      track(*tree);
      return;
    }
    emitter_.send(*lane_, std::move(values), {}, born);
  }
  if (id != nullptr) acked_at_once_.push_back(*id);
}

void SpoutTask::do_emit_from(std::shared_ptr<const TupleOrigin> origin, std::string_view stream, Values&& values,
                             MessageId id) {
  origin_ = std::move(origin);
  try {
    do_emit(stream, std::move(values), no_task, &id);
  } catch (...) {
    origin_.reset();
    throw;
  }
  origin_.reset();
}

void SpoutTask::take_acked_at_once() {
  // By index, because ack() may emit, which may add to the vector.
  for (std::size_t i = 0; i < acked_at_once_.size(); ++i) {
    const MessageId id = acked_at_once_[i];
    bump(counts_.acked);
    guarded("ack()", [&] { spout_->ack(id); });
  }
  acked_at_once_.clear();
}

// Trees.

void SpoutTask::tell(FlatList<Settlement>& settlements) noexcept {
  const bool many = settlements.size() >= many_settlements;
  {
    const config::MutexLock lock(settlements_mutex_);
    if (settlements_.empty()) {
      settlements_.swap(settlements);
    } else {
      settlements_.append({settlements.begin(), settlements.end()});
    }
    has_settlements_.store(true, std::memory_order_release);
  }
  settlements.clear();
  environment_.scheduler->schedule(*this, many);
}

/// \return true when the whole tree is acked.
inline bool SpoutTask::apply(const Settlement& settlement) {
  Tree& tree = *settlement.tree;
  tree.open ^= settlement.change;
  tree.flags |= settlement.flag;
  if (tree.open != 0 && (settlement.flag & Tree::failed) == 0) return false;
  if (tree.ending) {
    if (tree.ended && tree.open == 0) tree.recycle();
    return false;
  }
  tree.ending = true;
  if (tree.flags == 0) return true;
  if ((tree.flags & Tree::failed) != 0) {
    failing_.push_back(&tree);
  } else {
    tree.abandoned = true;
    bump(abandoned_);
  }
  return false;
}

/// The caller counts it.
[[gnu::always_inline]] inline void SpoutTask::finish_acked(Tree& tree) {
  unlink(tree);
  const MessageId id = tree.id;
  tree.recycle(lane_->trees());
  guarded("ack()", [&] { spout_->ack(id); });
}

void SpoutTask::take_settlements() {
  if (!has_settlements_.load(std::memory_order_acquire)) return;
  {
    const config::MutexLock lock(settlements_mutex_);
    settling_.swap(settlements_);
    has_settlements_.store(false, std::memory_order_relaxed);
  }
  // Trees that were emitted in one chunk of calls took equally long, as the clock is read once for a chunk.
  std::int64_t emitted_ns = 0;
  std::uint64_t equal = 0;
  const auto record = [&] {
    if (equal == 0) return;
    complete_latency_.record_ns(std::max<std::int64_t>(now_ns_ - emitted_ns, 0), equal);
    bump(counts_.acked, equal);
    bump(pending_, -std::exchange(equal, 0));
  };
  for (const Settlement& settlement : settling_) {
    if (!apply(settlement)) continue;
    if (settlement.tree->emitted_ns != emitted_ns) record();
    emitted_ns = settlement.tree->emitted_ns;
    ++equal;
    finish_acked(*settlement.tree);
  }
  record();
  settling_.clear();
  // After the others, which may blame the messages of these.
  for (Tree* tree : failing_) finish_failed(*tree, false);
  failing_.clear();
  take_acked_at_once();
}

/// Tells the spout that a tree failed, and forgets the tree when all deliveries are settled.
void SpoutTask::finish_failed(Tree& tree, bool timed_out) {
  unlink(tree);
  bump(pending_, -1);
  bump(counts_.failed);
  if (timed_out) bump(counts_.timed_out);
  note_failure(timed_out, tree.abandoned);
  const MessageId id = tree.id;
  const bool blamed = timed_out || (tree.flags & Tree::blamed) != 0;
  tree.ending = tree.ended = true;
  if (tree.open == 0) tree.recycle();
  dry_ = false;  // the spout may emit the message again
  if (blamed) {
    guarded("fail()", [&] { spout_->fail(id); });
  } else {
    guarded("retry()", [&] { spout_->retry(id); });
  }
}

void SpoutTask::note_failure(bool timed_out, bool dropped) {
  ++(dropped ? failures_.dropped : timed_out ? failures_.timed_out : failures_.by_bolt);
  if (std::exchange(failures_armed_, true)) return;
  const std::int64_t due = std::max(now_ns_ + gathering_failures.count(), next_failures_ns_);
  environment_.timers->add(config::Clock::Instant(std::chrono::nanoseconds(due)), *this, failures_due);
}

void SpoutTask::tell_failures() {
  failures_armed_ = false;
  next_failures_ns_ = now_ns_ + between_lines.count();
  const Failures failed = std::exchange(failures_, {});
  const auto total = failed.by_bolt + failed.timed_out + failed.dropped;
  if (total == 0) return;
  std::string causes;
  const auto add = [&](std::uint64_t count, const std::string& cause) {
    if (count > 0) causes += fmt::format("{}{} {}", causes.empty() ? "" : ", ", count, cause);
  };
  add(failed.timed_out, fmt::format("not done within the message time-out of {} ms (a bolt keeps them for longer, or "
                                    "they wait in full mailboxes)",
                                    environment_.options->message_timeout.count()));
  add(failed.by_bolt, "failed by a bolt, which threw or called fail()");
  add(failed.dropped, "dropped by a bolt without ack or fail");
  logger.warn("{}: component {}, task {}: {} tuples failed: {}", context_.topology, context_.component, context_.task,
              total, causes);
}

/// A tree that reset_timeout() has moved is found only when it is the oldest of its new slot.
void SpoutTask::note_oldest() {
  std::int64_t oldest = 0;
  if (pending_.load(std::memory_order_relaxed) > 0) {
    for (const Tree* tail : tails_) {
      if (tail != nullptr && (oldest == 0 || tail->emitted_ns < oldest)) oldest = tail->emitted_ns;
    }
  }
  oldest_ns_.store(oldest, std::memory_order_relaxed);
}

std::int64_t SpoutTask::slot_width_ns() const {
  const std::chrono::nanoseconds timeout = environment_.options->message_timeout;
  return std::max<std::int64_t>(timeout.count() / static_cast<std::int64_t>(slots - 1), 1);
}

void SpoutTask::arm_wheel() {
  wheel_armed_ = true;
  environment_.timers->add(config::Clock::Instant(std::chrono::nanoseconds(slot_ends_ns_)), *this, wheel_due);
}

void SpoutTask::turn_wheel() {
  const std::int64_t now = now_ns_;
  if (now < slot_ends_ns_) return;
  while (now >= slot_ends_ns_) {
    slot_ = (slot_ + 1) % slots;
    slot_ends_ns_ += slot_width_ns();
    expire(slot_, now);
    if (pending_.load(std::memory_order_relaxed) == 0) {
      wheel_armed_ = false;
      return;
    }
  }
  arm_wheel();
}

/// Fails the trees of the slot to which the wheel has just turned: they were put there nine turns ago.
void SpoutTask::expire(std::size_t slot, std::int64_t now) {
  const std::int64_t width = slot_width_ns();
  // From the oldest to the tree that is the newest now: fail() may emit, which puts new trees into this very slot.
  Tree* const newest = wheel_[slot];
  Tree* next = newest;
  while (next != nullptr && next->older != nullptr) next = next->older;
  while (next != nullptr) {
    Tree& due = *next;
    next = &due == newest ? nullptr : due.newer;
    const std::int64_t touched = due.touched_ns.load(std::memory_order_relaxed);
    const std::int64_t left = touched == 0 ? 0 : touched + width * static_cast<std::int64_t>(slots - 1) - now;
    if (left > 0) {
      // reset_timeout() was called: the tree moves to the slot that expires when its new time-out has passed.
      unlink(due);
      link(due, (slot + static_cast<std::size_t>((left + width - 1) / width)) % slots);
    } else {
      if (due.abandoned) bump(abandoned_, -1);
      finish_failed(due, true);
    }
  }
}

}  // namespace iotcloud::topology::internal
