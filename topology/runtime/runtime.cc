#include <algorithm>
#include <deque>
#include <set>
#include <thread>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/runtime/bolt_task.h>
#include <iotcloud/topology/runtime/executors.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/runtime/scheduler.h>
#include <iotcloud/topology/runtime/spout_task.h>
#include <iotcloud/topology/runtime/timers.h>

namespace iotcloud::topology {

using internal::BoltTask;
using internal::SpoutTask;
using internal::Task;

namespace {

constexpr config::Logger logger{"topology"};
// Between two looks at hanging tasks and at how busy all are.
constexpr std::chrono::milliseconds shortest_round{10};
constexpr std::chrono::milliseconds longest_round{5000};

/// Runs user code of set-up; what it throws becomes a TopologyError that names the component.
template <typename Call>
auto set_up(const std::string& component, const std::string& what, Call&& call) {
  try {
    return call();
  } catch (const TopologyError&) {
    throw;
  } catch (const std::exception& e) {
    throw TopologyError(component, "component \"" + component + "\": " + what + " threw: " + e.what());
  } catch (...) {
    throw TopologyError(component, "component \"" + component + "\": " + what + " threw no std::exception");
  }
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
    sum.executed += task.executed;
    sum.acked += task.acked;
    sum.failed += task.failed;
    sum.timed_out += task.timed_out;
    sum.errors += task.errors;
    sum.queue_depth += task.queue_depth;
    sum.pending += task.pending;
    sum.late += task.late;
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
        clock_is_real_(&clock_ == &config::system_clock()),
        timers_(clock_, clock_is_real_),
        scheduler_(options_.threads, options_.caller_slice, count_tasks(), timers_) {
    name_tasks();
    for (const ComponentSpec& spec : topology_.components) make_tasks(spec);
    for (const auto& task : tasks_) task->emitter().set_up(streams_of(*task), &bolts_, task.get());
    metrics_source_ = metrics_.add_source([this](std::vector<config::Sample>& samples) {
      for (const auto& task : tasks_) task->collect(samples);
    });
  }

  ~Impl() {
    stop(std::chrono::milliseconds(0));
    timers_.stop();
    scheduler_.join();
    for (SpoutTask* spout : spouts_) spout->gate().shut();
    // Tuples that bolts keep may still tell the spouts' tasks of their end.
    for (BoltTask* bolt : bolts_) {
      if (bolt != nullptr) bolt->discard();
    }
  }

  void start() {
    prepare_all();
    scheduler_.start();
    if (clock_is_real_ || options_.threads > 0) {
      const auto often_enough = options_.hang_after.count() > 0 ? options_.hang_after / 2 : longest_round;
      timers_.start(scheduler_, std::clamp(often_enough, shortest_round, longest_round), [this] { go_round(); });
    }
    started_ = true;
    for (const auto& task : tasks_) {
      if (task->is_spout()) task->signal(Task::activity_due);
      scheduler_.release(*task, false);
    }
    for (const ComponentSpec& spec : topology_.components) {
      if (spec.tick.count() == 0) continue;
      for (const int id : tasks_of_->at(spec.id)) {
        timers_.add(clock_.now() + spec.tick, *bolts_[static_cast<std::size_t>(id)], Task::tick_due, spec.tick);
      }
    }
  }

  bool stop(std::chrono::milliseconds limit) {
    const std::lock_guard lock(stop_mutex_);
    if (stopped_) return stopped_in_time_;
    stopped_ = true;
    stopped_in_time_ = true;
    if (!started_) return true;
    const auto deadline = std::chrono::steady_clock::now() + limit;
    timers_.end_periodic();
    set_active(false);
    const bool drained = drain(deadline);
    scheduler_.halt();
    const bool quiet = scheduler_.wait_halted(deadline);
    // Sources before those they feed, as they were made.
    for (const auto& task : tasks_) {
      if (!scheduler_.runs(*task)) {
        task->close();
      } else {
        logger.error("{}: component {}, task {} does not return from user code", topology_.name,
                     task->context().component, task->id());
      }
    }
    stopped_in_time_ = drained && quiet;
    return stopped_in_time_;
  }

  void set_active(bool active) {
    active_.store(active);
    for (SpoutTask* spout : spouts_) spout->set_active(active);
  }

  Snapshot snapshot() const {
    Snapshot snapshot;
    snapshot.topology = topology_.name;
    snapshot.active = started_ && active_.load();
    for (const auto& [id, executors] : executors_) snapshot.parallelism[id] = executors.limit();
    for (const auto& task : tasks_) snapshot.tasks.push_back(task->snapshot());
    return snapshot;
  }

  void rebalance(const std::string& component, int parallelism) {
    const auto executors = executors_.find(component);
    if (executors == executors_.end()) throw std::invalid_argument(no_component(component));
    const auto tasks = static_cast<int>(tasks_of_->at(component).size());
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
      explicit OwnedTap(std::vector<std::shared_ptr<internal::TapPoint>> points) : points_(std::move(points)) {}
      ~OwnedTap() override {
        for (const auto& point : points_) point->end();
      }

     private:
      std::vector<std::shared_ptr<internal::TapPoint>> points_;
    };
    if (!tasks_of_->contains(component)) throw std::invalid_argument(no_component(component));
    const auto one_at_a_time = [mutex = std::make_shared<std::mutex>(), call = std::move(call)](const Tuple& tuple,
                                                                                                int task) {
      const std::lock_guard lock(*mutex);
      call(tuple, task);
    };
    std::vector<std::shared_ptr<internal::TapPoint>> points;
    for (const auto& task : tasks_) {
      if (task->context().component != component) continue;
      points.push_back(std::make_shared<internal::TapPoint>(per_second, one_at_a_time));
      task->taps().add(points.back());
    }
    return std::make_unique<OwnedTap>(std::move(points));
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

  std::string no_component(const std::string& id) const {
    std::string known;
    for (const ComponentSpec& spec : topology_.components) known += (known.empty() ? "" : ", ") + spec.id;
    return "topology \"" + topology_.name + "\" has no component \"" + id + "\"; it has: " + known;
  }

  void name_tasks() {
    int id = 0;
    auto tasks_of = std::make_shared<std::map<std::string, std::vector<int>>>();
    for (const ComponentSpec& spec : topology_.components) {
      for (int i = 0; i < spec.tasks; ++i) (*tasks_of)[spec.id].push_back(++id);
      executors_.try_emplace(spec.id, spec.parallelism, spec.tasks);
      has_deadlines_ = has_deadlines_ || spec.deadline.count() > 0 ||
                       std::any_of(spec.inputs.begin(), spec.inputs.end(),
                                   [](const Subscription& input) { return input.deadline.count() > 0; });
    }
    tasks_of_ = std::move(tasks_of);
    bolts_.resize(static_cast<std::size_t>(id) + 1, nullptr);
    for (const auto& [component, streams] : topology_.streams) {
      for (const auto& [stream, spec] : streams) {
        stream_infos_[{component, stream}] = detail::StreamInfo{component, stream, spec.fields};
      }
    }
  }

  TopologyContext context_of(const ComponentSpec& spec, std::size_t index) {
    TopologyContext context;
    context.topology = topology_.name;
    context.component = spec.id;
    context.task = tasks_of_->at(spec.id)[index];
    context.task_index = static_cast<int>(index);
    context.task_count = spec.tasks;
    context.tasks_of = tasks_of_;
    context.clock = &clock_;
    context.metrics = &metrics_;
    return context;
  }

  void make_tasks(const ComponentSpec& spec) {
    const internal::Surroundings around{&scheduler_, &timers_, &clock_, &options_, clock_is_real_, has_deadlines_};
    for (std::size_t i = 0; i < static_cast<std::size_t>(spec.tasks); ++i) {
      TopologyContext context = context_of(spec, i);
      if (spec.spout) {
        auto spout = set_up(spec.id, "its factory", [&] { return spec.spout(); });
        auto gate = std::make_shared<internal::WakeGate>();
        context.waker = SpoutWaker(gate);
        auto task = std::make_unique<SpoutTask>(around, std::move(context), std::move(spout), std::move(gate),
                                                spec.max_spout_pending.value_or(options_.max_spout_pending));
        spouts_.push_back(task.get());
        tasks_.push_back(std::move(task));
      } else {
        auto bolt = set_up(spec.id, "its factory", [&] { return spec.bolt(); });
        auto task =
            std::make_unique<BoltTask>(around, std::move(context), std::move(bolt), intake_of(spec), &tick_stream_);
        bolts_[static_cast<std::size_t>(task->id())] = task.get();
        tasks_.push_back(std::move(task));
      }
      tasks_.back()->executors = &executors_.at(spec.id);
    }
  }

  internal::Intake intake_of(const ComponentSpec& bolt) const {
    internal::Intake intake;
    intake.late_stream = bolt.late_stream;
    for (const Subscription& input : bolt.inputs) {
      const auto* stream = &stream_infos_.at({input.from, input.stream});
      const auto shorter = bolt.deadline.count() == 0    ? input.deadline
                           : input.deadline.count() == 0 ? bolt.deadline
                                                         : std::min(bolt.deadline, input.deadline);
      if (shorter.count() > 0) intake.deadlines.push_back({stream, std::chrono::nanoseconds(shorter).count()});
      if (input.keep_last == 0) continue;
      internal::KeepLast& keep = intake.keep_last.emplace_back();
      keep.stream = stream;
      keep.keep = input.keep_last;
      for (const std::string& name : input.keep_key.empty() ? input.fields : input.keep_key) {
        keep.key.push_back(stream->fields.find(name).value());  // build() checked that it is there
      }
    }
    return intake;
  }

  std::vector<internal::OutStream> streams_of(const Task& emitter) {
    std::vector<internal::OutStream> streams;
    const std::string& component = emitter.context().component;
    const auto declared = topology_.streams.find(component);
    if (declared == topology_.streams.end()) return streams;
    for (const auto& [name, spec] : declared->second) {
      internal::OutStream out{&stream_infos_.at({component, name}), spec.direct, {}};
      for (const ComponentSpec& reader : topology_.components) {
        for (const Subscription& input : reader.inputs) {
          if (input.from != component || input.stream != name) continue;
          internal::Edge edge{nullptr, &tasks_of_->at(reader.id), input.grouping == "custom"};
          const bool one_for_all = edge.targets->size() == 1 && !edge.custom;
          if (!spec.direct && !one_for_all) {
            set_up(reader.id, "its grouping on " + component, [&] {
              edge.grouping = input.factory();
              edge.grouping->prepare(emitter.context(), spec.fields, *edge.targets);
            });
          }
          out.edges.push_back(std::move(edge));
        }
      }
      streams.push_back(std::move(out));
    }
    return streams;
  }

  /// Bolts before what feeds them.
  void prepare_all() {
    try {
      for (auto task = tasks_.rbegin(); task != tasks_.rend(); ++task) {
        const std::string& id = (*task)->context().component;
        const auto& spec = *std::find_if(topology_.components.begin(), topology_.components.end(),
                                         [&](const ComponentSpec& c) { return c.id == id; });
        Config config = spec.config;
        config.insert(topology_.config.begin(), topology_.config.end());
        if ((*task)->is_spout()) {
          set_up(id, "open()", [&] { static_cast<SpoutTask&>(**task).open(config, scheduler_.spare_lane()); });
        } else {
          set_up(id, "prepare()", [&] { static_cast<BoltTask&>(**task).prepare(config, scheduler_.spare_lane()); });
        }
      }
    } catch (...) {
      for (const auto& task : tasks_) task->close();
      throw;
    }
  }

  /// Once in a while, on the timers' thread.
  void go_round() {
    if (options_.hang_after.count() > 0) scheduler_.report_hanging(options_.hang_after);
    const std::int64_t now =
        std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
            .count();
    for (const auto& task : tasks_) task->measure_capacity(now);
  }

  bool drain(std::chrono::steady_clock::time_point deadline) {
    const auto done = [this] {
      return std::all_of(spouts_.begin(), spouts_.end(), [](const SpoutTask* s) { return s->under_way() == 0; });
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
  const bool clock_is_real_;
  std::shared_ptr<const std::map<std::string, std::vector<int>>> tasks_of_;
  std::map<std::string, internal::Executors> executors_;  ///< by component
  bool has_deadlines_ = false;
  std::map<std::pair<std::string, std::string>, detail::StreamInfo> stream_infos_;  ///< nodes stay where they are
  const detail::StreamInfo tick_stream_{system_component, tick_stream, {}};
  internal::Timers timers_;
  internal::Scheduler scheduler_;
  std::vector<std::unique_ptr<Task>> tasks_;  ///< sources first
  std::vector<BoltTask*> bolts_;              ///< by task id; null where that is no bolt
  std::vector<SpoutTask*> spouts_;
  std::atomic<bool> active_{true};
  std::atomic<bool> started_{false};
  std::mutex stop_mutex_;
  bool stopped_ = false;                                ///< guarded by stop_mutex_
  bool stopped_in_time_ = false;                        ///< guarded by stop_mutex_
  config::Metrics::SourceRegistration metrics_source_;  ///< dies first: it reads the tasks
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
bool Runtime::idle() const {
  return impl_->scheduler().idle();
}

}  // namespace iotcloud::topology
