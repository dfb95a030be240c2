#include <algorithm>

#include <iotcloud/topology/runtime/logger.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/tasks/send.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

namespace {
constexpr std::int64_t log_pause_ns = 1'000'000'000;
}  // namespace

namespace {

TopologyContext with(TopologyContext context, Holdings& holdings) {
  context.holdings = &holdings;
  return context;
}

}  // namespace

Task::Task(const TaskEnvironment& environment, Executors& executors, Role role, TopologyContext context)
    : Runnable(executors, role, context.task_count > 1 ? context.task_index : anywhere),
      environment_(environment),
      context_(with(std::move(context), holdings_)) {}

void Task::signal(std::uint32_t bits) {
  signals_.fetch_or(bits, std::memory_order_acq_rel);
  environment_.scheduler->schedule(*this);
}

void Task::hangs(std::int64_t for_ns) {
  report_error("does not return from user code for " + std::to_string(for_ns / 1'000'000) + " ms");
}

void Task::unblock() {
  if (blocked_on_.fetch_sub(1, std::memory_order_acq_rel) == 1) environment_.scheduler->schedule(*this, true);
}

TaskSnapshot Task::snapshot() const {
  TaskSnapshot snapshot;
  snapshot.component = context_.component;
  snapshot.task_id = context_.task;
  snapshot.spout = is_spout();
  snapshot.emitted = counts_.emitted.load(std::memory_order_relaxed);
  snapshot.transferred = counts_.transferred.load(std::memory_order_relaxed);
  snapshot.streams = emitter_.counts(snapshot.emitted, snapshot.transferred);
  snapshot.executed = counts_.executed.load(std::memory_order_relaxed);
  snapshot.acked = counts_.acked.load(std::memory_order_relaxed);
  snapshot.failed = counts_.failed.load(std::memory_order_relaxed);
  snapshot.timed_out = counts_.timed_out.load(std::memory_order_relaxed);
  snapshot.errors = counts_.errors.load(std::memory_order_relaxed);
  snapshot.late = counts_.late.load(std::memory_order_relaxed);
  snapshot.busy_seconds = static_cast<double>(counts_.busy_ns.load(std::memory_order_relaxed)) / 1e9;
  snapshot.capacity = capacity_.load(std::memory_order_relaxed);
  snapshot.queue_depth = depth();
  {
    const config::MutexLock lock(error_mutex_);
    snapshot.last_error = last_error_;
  }
  snapshot.window_tuples = holdings_.window_tuples.load(std::memory_order_relaxed);
  snapshot.state_entries = holdings_.state_entries.load(std::memory_order_relaxed);
  snapshot.state_bytes = holdings_.state_bytes.load(std::memory_order_relaxed);
  fill(snapshot);
  return snapshot;
}

void Task::report_error(const std::string& text) noexcept {
  try {
    counts_.errors.fetch_add(1, std::memory_order_relaxed);
    const std::int64_t now = environment_.clock->now().time_since_epoch().count();
    bool log = false;
    std::uint64_t unlogged = 0;
    {
      const config::MutexLock lock(error_mutex_);
      last_error_ = text;
      log = last_log_ns_ == 0 || now - last_log_ns_ >= log_pause_ns;
      if (log) {
        last_log_ns_ = now;
        unlogged = std::exchange(unlogged_, 0);
      } else {
        ++unlogged_;
      }
    }
    if (log) {
      logger.error("{}: component {}, task {}: {}{}", context_.topology, context_.component, context_.task, text,
                   unlogged > 0 ? " (and " + std::to_string(unlogged) + " errors before it)" : "");
    }
    if (environment_.options->on_error) environment_.options->on_error(context_.component, context_.task, text);
  } catch (...) {
    logger.error("{}: component {}: an error could not be reported", context_.topology, context_.component);
  }
}

void Task::offer_emitted(const Values& values, std::int64_t born_ns) {
  taps_.offer(real_ns(), id(),
              [&] { return Tuple::adopt(emitter_.make_cell(Pool<TupleCell>::local(), Values(values), born_ns)); });
}

void Task::note_emitted(const TupleCell& cell) const {
  const std::int64_t now = topology_ns();
  for_each_trace(cell, [&](TupleTrace& trace) { trace.emitted(context_, cell, now); });
}

void Task::measure_capacity(std::int64_t now_ns) {
  const std::uint64_t busy = counts_.busy_ns.load(std::memory_order_relaxed);
  if (capacity_since_ns_ != 0 && now_ns > capacity_since_ns_) {
    const auto passed = static_cast<double>(now_ns - capacity_since_ns_);
    capacity_.store(std::min(1.0, static_cast<double>(busy - capacity_busy_ns_) / passed), std::memory_order_relaxed);
  }
  capacity_since_ns_ = now_ns;
  capacity_busy_ns_ = busy;
}

void Task::add_sample(std::vector<config::Sample>& samples, const char* name, const char* help,
                      const config::Histogram& histogram) const {
  config::Sample sample;
  sample.name = name;
  sample.help = help;
  sample.labels = {
      {"topology", context_.topology}, {"component", context_.component}, {"task", std::to_string(context_.task)}};
  sample.kind = config::Sample::Kind::histogram;
  sample.histogram = histogram.summary();
  if (sample.histogram.count > 0) samples.push_back(std::move(sample));
}

void Task::collect(std::vector<config::Sample>& samples) const {
  const config::Labels labels{
      {"topology", context_.topology}, {"component", context_.component}, {"task", std::to_string(context_.task)}};
  const TaskSnapshot now = snapshot();
  const auto add = [&](const char* name, const char* help, config::Sample::Kind kind, double value) {
    samples.push_back({name, help, labels, kind, value, {}});
  };
  const auto count = [&](const char* name, const char* help, std::uint64_t value) {
    add(name, help, config::Sample::Kind::counter, static_cast<double>(value));
  };
  count("iotcloud_task_emitted_total", "Tuples that the component emitted", now.emitted);
  count("iotcloud_task_transferred_total", "Deliveries of emitted tuples to tasks", now.transferred);
  count("iotcloud_task_executed_total", "Tuples executed (spouts: calls of next_tuple that returned true)",
        now.executed);
  count("iotcloud_task_acked_total", "Tuples acked (spouts: whole trees)", now.acked);
  count("iotcloud_task_failed_total", "Tuples failed (spouts: whole trees, time-outs included)", now.failed);
  count("iotcloud_task_timed_out_total", "Trees that failed by the message time-out", now.timed_out);
  count("iotcloud_task_errors_total", "Exceptions and reported errors of user code", now.errors);
  count("iotcloud_task_late_total", "Tuples older than their deadline, not executed", now.late);
  count("iotcloud_task_superseded_total", "Tuples that a newer one of their key replaced (keep_last)", now.superseded);
  add("iotcloud_task_busy_seconds_total", "Time in user code", config::Sample::Kind::counter, now.busy_seconds);
  add("iotcloud_task_queue_depth", "Tuples in the task's mailbox", config::Sample::Kind::gauge,
      static_cast<double>(now.queue_depth));
  if (now.spout) {
    add("iotcloud_spout_pending", "Messages of a spout that are not processed to the end", config::Sample::Kind::gauge,
        static_cast<double>(now.pending));
    add("iotcloud_spout_oldest_seconds", "Time since the oldest of these messages was emitted",
        config::Sample::Kind::gauge, now.oldest_seconds);
  }
  const auto keeps = [&](const char* name, const char* help, std::int64_t value) {
    if (value >= 0) add(name, help, config::Sample::Kind::gauge, static_cast<double>(value));
  };
  keeps("iotcloud_task_window_tuples", "Tuples that a windowed bolt keeps for later windows", now.window_tuples);
  keeps("iotcloud_task_state_entries", "Keys of a stateful bolt's state in memory", now.state_entries);
  keeps("iotcloud_task_state_bytes", "Bytes of these keys and their values", now.state_bytes);
  add("iotcloud_task_capacity", "Part of the last seconds in which the task was busy, 0 to 1",
      config::Sample::Kind::gauge, now.capacity);
}

}  // namespace iotcloud::topology::internal
