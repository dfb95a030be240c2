#include <iotcloud/config/log.h>
#include <iotcloud/topology/runtime/scheduler.h>
#include <iotcloud/topology/runtime/task.h>

namespace iotcloud::topology::internal {

namespace {
constexpr config::Logger logger{"topology"};
constexpr std::int64_t log_pause_ns = 1'000'000'000;
}  // namespace

Task::Task(const Surroundings& surroundings, TopologyContext context)
    : around_(surroundings), context_(std::move(context)) {
  const config::Labels labels{
      {"topology", context_.topology}, {"component", context_.component}, {"task", std::to_string(context_.task)}};
  const auto publish = [&](const char* name, const char* help, std::atomic<std::uint64_t>& count) {
    published_.push_back({&context_.metrics->counter(name, help, labels), &count, 0});
  };
  publish("iotcloud_task_emitted_total", "Tuples handed to emit", counts_.emitted);
  publish("iotcloud_task_transferred_total", "Tuples sent to tasks", counts_.transferred);
  publish("iotcloud_task_executed_total", "Tuples worked on", counts_.executed);
  publish("iotcloud_task_acked_total", "Tuples acked (spouts: whole trees)", counts_.acked);
  publish("iotcloud_task_failed_total", "Tuples failed (spouts: whole trees, time-outs included)", counts_.failed);
  publish("iotcloud_task_errors_total", "Exceptions and reported errors of user code", counts_.errors);
}

void Task::signal(std::uint32_t bits) {
  signals_.fetch_or(bits, std::memory_order_acq_rel);
  around_.scheduler->schedule(*this);
}

void Task::unblock() {
  if (blocked_on_.fetch_sub(1, std::memory_order_acq_rel) == 1) around_.scheduler->schedule(*this);
}

TaskSnapshot Task::snapshot() const {
  TaskSnapshot snapshot;
  snapshot.component = context_.component;
  snapshot.task_id = context_.task;
  snapshot.spout = is_spout();
  snapshot.emitted = counts_.emitted.load(std::memory_order_relaxed);
  snapshot.transferred = counts_.transferred.load(std::memory_order_relaxed);
  snapshot.executed = counts_.executed.load(std::memory_order_relaxed);
  snapshot.acked = counts_.acked.load(std::memory_order_relaxed);
  snapshot.failed = counts_.failed.load(std::memory_order_relaxed);
  snapshot.timed_out = counts_.timed_out.load(std::memory_order_relaxed);
  snapshot.errors = counts_.errors.load(std::memory_order_relaxed);
  snapshot.queue_depth = depth();
  {
    const std::lock_guard lock(error_mutex_);
    snapshot.last_error = last_error_;
  }
  fill(snapshot);
  return snapshot;
}

void Task::report_error(const std::string& text) noexcept {
  try {
    counts_.errors.fetch_add(1, std::memory_order_relaxed);
    const std::int64_t now = around_.clock->now().time_since_epoch().count();
    bool log = false;
    std::uint64_t unlogged = 0;
    {
      const std::lock_guard lock(error_mutex_);
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
    if (around_.options->on_error) around_.options->on_error(context_.component, context_.task, text);
  } catch (...) {
    logger.error("{}: component {}: an error could not be reported", context_.topology, context_.component);
  }
}

void Task::publish_counts() {
  for (Published& published : published_) {
    const std::uint64_t now = published.count->load(std::memory_order_relaxed);
    if (now == published.seen) continue;
    published.counter->add(now - published.seen);
    published.seen = now;
  }
}

}  // namespace iotcloud::topology::internal
