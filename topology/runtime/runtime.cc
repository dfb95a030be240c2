#include <algorithm>
#include <deque>
#include <set>
#include <thread>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/logger.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>
#include <iotcloud/topology/runtime/task_graph.h>
#include <iotcloud/topology/runtime/tasks/emitting_lane.h>

namespace iotcloud::topology {

using internal::Task;

namespace {

// Limits of the time between two rounds, in which go_round() looks for hanging tasks and measures how busy each task
// is.
constexpr std::chrono::milliseconds shortest_round{10};
constexpr std::chrono::milliseconds longest_round{5000};

/// \param kept -1: nothing of the kind
void add_kept(std::int64_t& sum, std::int64_t kept) {
  if (kept >= 0) sum = std::max<std::int64_t>(sum, 0) + kept;
}

}  // namespace

unsigned RuntimeOptions::default_threads() {
  return std::max(1U, std::thread::hardware_concurrency());
}

TaskSnapshot Snapshot::component(const std::string& id) const {
  TaskSnapshot sum;
  sum.component = id;
  for (const TaskSnapshot& task : tasks) {
    if (task.component != id) continue;
    sum.spout = task.spout;
    sum.emitted += task.emitted;
    sum.transferred += task.transferred;
    sum.streams.resize(task.streams.size());  // all tasks of a component have the same
    for (std::size_t i = 0; i < task.streams.size(); ++i) {
      sum.streams[i].stream = task.streams[i].stream;
      sum.streams[i].emitted += task.streams[i].emitted;
      sum.streams[i].transferred += task.streams[i].transferred;
    }
    sum.inputs.resize(task.inputs.size());  // here, too
    for (std::size_t i = 0; i < task.inputs.size(); ++i) {
      const InputSnapshot& input = task.inputs[i];
      sum.inputs[i].from = input.from;
      sum.inputs[i].stream = input.stream;
      sum.inputs[i].executed += input.executed;
      sum.inputs[i].acked += input.acked;
      sum.inputs[i].failed += input.failed;
      sum.inputs[i].late += input.late;
    }
    sum.executed += task.executed;
    sum.acked += task.acked;
    sum.failed += task.failed;
    sum.timed_out += task.timed_out;
    sum.errors += task.errors;
    sum.queue_depth += task.queue_depth;
    sum.pending += task.pending;
    sum.oldest_seconds = std::max(sum.oldest_seconds, task.oldest_seconds);
    sum.late += task.late;
    add_kept(sum.window_tuples, task.window_tuples);
    add_kept(sum.state_entries, task.state_entries);
    add_kept(sum.state_bytes, task.state_bytes);
    sum.superseded += task.superseded;
    sum.busy_seconds += task.busy_seconds;
    sum.capacity = std::max(sum.capacity, task.capacity);
    if (!task.last_error.empty()) sum.last_error = task.last_error;
    if (task.execute_latency.count > sum.execute_latency.count) sum.execute_latency = task.execute_latency;
    if (task.process_latency.count > sum.process_latency.count) sum.process_latency = task.process_latency;
    if (task.complete_latency.count > sum.complete_latency.count) sum.complete_latency = task.complete_latency;
  }
  return sum;
}

class Runtime::Impl {
 public:
  Impl(Topology topology, RuntimeOptions options)
      : topology_(std::move(topology)),
        options_(std::move(options)),
        clock_(options_.clock != nullptr ? *options_.clock : config::system_clock()),
        metrics_(options_.metrics != nullptr ? *options_.metrics : config::process_metrics()),
        troubles_(options_.troubles != nullptr ? *options_.troubles : own_troubles_),
        clock_is_real_(&clock_ == &config::system_clock()),
        timers_(clock_, clock_is_real_),
        scheduler_(options_.threads, options_.caller_slice, options_.long_slice, emitting_lanes(), timers_),
        graph_(topology_, {&scheduler_, &timers_, &clock_, &options_, clock_is_real_, false, &troubles_}, metrics_) {
    metrics_source_ = metrics_.add_source([this](std::vector<config::Sample>& samples) {
      for (const auto& task : graph_.tasks()) task->collect(samples);
    });
  }

  ~Impl() {
    stop(std::chrono::milliseconds(0));
    timers_.stop();
    scheduler_.join();
    for (internal::SpoutTask* spout : graph_.spouts()) spout->gate().shut();  // no thread runs a task any more
    // does something only for tasks that were in user code in stop()
    for (const auto& task : graph_.tasks()) task->close();
  }

  void start() {
    graph_.prepare(internal::EmittingLane::of(scheduler_.spare_lane()));
    scheduler_.start();
    if (clock_is_real_ || options_.threads > 0) {
      const auto often_enough = options_.hang_after.count() > 0 ? options_.hang_after / 2 : longest_round;
      timers_.start(scheduler_, std::clamp(often_enough, shortest_round, longest_round), [this] { go_round(); });
    }
    started_ = true;
    for (const auto& task : graph_.tasks()) {
      if (task->is_spout()) task->signal(Task::activity_due);
      scheduler_.release(*task, false);
    }
    for (const auto& task : graph_.tasks()) {
      const auto tick = graph_.spec_of(*task).tick;
      if (tick.count() > 0) timers_.add(clock_.now() + tick, *task, Task::tick_due, tick);
    }
  }

  bool stop(std::chrono::milliseconds limit) {
    const config::MutexLock lock(stop_mutex_);
    if (stopped_) return stopped_in_time_;
    stopped_ = true;
    stopped_in_time_ = true;
    if (!started_) return true;
    const auto deadline = std::chrono::steady_clock::now() + limit;
    set_active(false);
    const bool drained = drain(deadline);  // ticks go on, because some bolts ack their tuples at a tick
    timers_.end_periodic();
    scheduler_.halt();
    const bool quiet = scheduler_.wait_halted(deadline);
    // A source is closed before the bolts that it feeds: tasks() has this order.
    for (const auto& task : graph_.tasks()) {
      if (!scheduler_.runs(*task)) {
        task->close();
      } else if (limit.count() > 0) {
        logger.error("{}: component {}, task {} has not returned from user code; it is cleaned up when it does",
                     topology_.name, task->context().component, task->id());
      }
    }
    stopped_in_time_ = drained && quiet;
    return stopped_in_time_;
  }

  void set_active(bool active) {
    active_.store(active);
    for (internal::SpoutTask* spout : graph_.spouts()) spout->set_active(active);
  }

  Snapshot snapshot() const {
    Snapshot snapshot;
    snapshot.topology = topology_.name;
    snapshot.active = started_ && active_.load();
    for (const auto& [id, executors] : graph_.executors()) snapshot.parallelism[id] = executors.limit();
    for (const auto& task : graph_.tasks()) snapshot.tasks.push_back(task->snapshot());
    snapshot.troubles = troubles_.list();
    return snapshot;
  }

  void rebalance(const std::string& component, int parallelism) {
    const auto executors = graph_.executors().find(component);
    if (executors == graph_.executors().end()) throw std::invalid_argument(no_component(component));
    const auto tasks = static_cast<int>(graph_.tasks_of().at(component).size());
    if (parallelism < 1 || parallelism > tasks) {
      throw std::invalid_argument("component \"" + component + "\" cannot have a parallelism of " +
                                  std::to_string(parallelism) + ": it has " + std::to_string(tasks) +
                                  " tasks, so 1 to " + std::to_string(tasks) + " are possible");
    }
    scheduler_.set_limit(executors->second, parallelism);
  }

  std::unique_ptr<Tap> tap(const std::string& component, double per_second, TapCall call) {
    class OwnedTap final : public Tap {
     public:
      explicit OwnedTap(std::shared_ptr<internal::TapWatcher> watcher) : watcher_(std::move(watcher)) {}
      ~OwnedTap() override { watcher_->end(); }

     private:
      const std::shared_ptr<internal::TapWatcher> watcher_;
    };
    if (!graph_.tasks_of().contains(component)) throw std::invalid_argument(no_component(component));
    const auto watcher = std::make_shared<internal::TapWatcher>(std::move(call));
    for (const auto& task : graph_.tasks()) {
      if (task->context().component != component) continue;
      task->taps().add(std::make_shared<internal::TapPoint>(per_second, watcher));
    }
    return std::make_unique<OwnedTap>(watcher);
  }

  void trace(bool on) {
    for (const auto& task : graph_.tasks()) task->taps().trace(on);
  }

  LongCall longest_call() const {
    const auto longest = scheduler_.longest_slice();
    for (const auto& task : graph_.tasks()) {
      if (task.get() != longest.task) continue;
      const std::chrono::nanoseconds age{longest.for_ns};
      return {task->context().component, task->context().task,
              std::chrono::duration_cast<std::chrono::milliseconds>(age)};
    }
    return {};
  }

  const Topology& topology() const { return topology_; }
  internal::Scheduler& scheduler() { return scheduler_; }
  internal::Timers& timers() { return timers_; }

 private:
  std::size_t count_tasks() const {
    std::size_t count = 0;
    for (const ComponentSpec& spec : topology_.components) count += static_cast<std::size_t>(spec.tasks);
    return count;
  }

  internal::Scheduler::MakeLane emitting_lanes() const {
    return [tasks = count_tasks()](internal::Scheduler& scheduler) {
      return std::make_unique<internal::EmittingLane>(scheduler, tasks);
    };
  }

  std::string no_component(const std::string& id) const {
    std::string known;
    for (const ComponentSpec& spec : topology_.components) known += (known.empty() ? "" : ", ") + spec.id;
    return "topology \"" + topology_.name + "\" has no component \"" + id + "\"; it has: " + known;
  }

  /// The timers' thread calls it once in a round.
  void go_round() {
    if (options_.hang_after.count() > 0) scheduler_.report_hanging(options_.hang_after);
    const std::int64_t now =
        std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
            .count();
    for (const auto& task : graph_.tasks()) task->measure_capacity(now);
  }

  bool drain(std::chrono::steady_clock::time_point deadline) {
    const auto done = [this] {
      const auto& spouts = graph_.spouts();
      return std::all_of(spouts.begin(), spouts.end(), [](const auto* spout) { return spout->under_way() == 0; });
    };
    if (options_.threads == 0) {
      scheduler_.run_until_idle();
      return scheduler_.idle() && done();
    }
    return scheduler_.wait_idle(deadline, done);
  }

  const Topology topology_;
  const RuntimeOptions options_;
  const config::Clock& clock_;
  config::Metrics& metrics_;
  TroubleBoard own_troubles_;
  TroubleBoard& troubles_;
  const bool clock_is_real_;
  internal::Timers timers_;
  internal::Scheduler scheduler_;
  internal::TaskGraph graph_;
  std::atomic<bool> active_{true};
  std::atomic<bool> started_{false};
  config::Mutex stop_mutex_;
  bool stopped_ IOTCLOUD_GUARDED_BY(stop_mutex_) = false;
  bool stopped_in_time_ IOTCLOUD_GUARDED_BY(stop_mutex_) = false;
  config::Metrics::SourceRegistration metrics_source_;  ///< destroyed first, because it reads the tasks
};

Runtime::Runtime(Topology topology, RuntimeOptions options)
    : impl_(std::make_unique<Impl>(std::move(topology), std::move(options))) {}
Runtime::~Runtime() = default;

void Runtime::start() {
  impl_->start();
}
bool Runtime::stop(std::chrono::milliseconds limit) {
  return impl_->stop(limit);
}
void Runtime::deactivate() {
  impl_->set_active(false);
}
void Runtime::activate() {
  impl_->set_active(true);
}
void Runtime::rebalance(const std::string& component, int parallelism) {
  impl_->rebalance(component, parallelism);
}
std::unique_ptr<Tap> Runtime::tap(const std::string& component, double per_second, TapCall call) {
  return impl_->tap(component, per_second, std::move(call));
}
void Runtime::trace(bool on) {
  impl_->trace(on);
}
Snapshot Runtime::snapshot() const {
  return impl_->snapshot();
}
const Topology& Runtime::topology() const {
  return impl_->topology();
}
void Runtime::run_until_idle() {
  impl_->scheduler().run_until_idle();
}
void Runtime::run_due_timers() {
  impl_->timers().run_due();
}
LongCall Runtime::longest_call() const {
  return impl_->longest_call();
}
bool Runtime::idle() const {
  return impl_->scheduler().idle();
}

}  // namespace iotcloud::topology
