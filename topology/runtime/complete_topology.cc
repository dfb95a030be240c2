#include <algorithm>
#include <deque>
#include <limits>
#include <memory>

#include <iotcloud/topology/runtime/complete_topology.h>

namespace iotcloud::topology {

namespace {

/// The tuples that put() gave a spout and that it has not emitted yet: a queue for each of its tasks.
struct Feed {
  explicit Feed(int tasks) : waiting(static_cast<std::size_t>(tasks)), wakers(waiting.size()) {}
  void add(Values values) { waiting[next++ % waiting.size()].push_back(std::move(values)); }
  void wake() const {
    for (const SpoutWaker& waker : wakers) waker.wake();
  }

  std::vector<std::deque<Values>> waiting;
  std::vector<SpoutWaker> wakers;
  std::size_t next = 0;
};

/// Replaces a spout: emits what its Feed holds.
class FedSpout final : public Spout {
 public:
  explicit FedSpout(std::shared_ptr<Feed> feed) : feed_(std::move(feed)) {}
  void declare_output_fields(OutputFieldsDeclarer&) const override {}  // build() asked the spout that this one replaces
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    const auto index = static_cast<std::size_t>(context.task_index);
    feed_->wakers[index] = context.waker;
    waiting_ = &feed_->waiting[index];
  }
  bool next_tuple() override {
    if (waiting_->empty()) return false;
    Values values = std::move(waiting_->front());
    waiting_->pop_front();
    collector_->emit(std::move(values), ++last_id_);
    return true;
  }

 private:
  std::shared_ptr<Feed> feed_;
  std::deque<Values>* waiting_ = nullptr;
  SpoutOutputCollector* collector_ = nullptr;
  MessageId last_id_ = 0;
};

std::vector<std::vector<Value>> select(const std::vector<EmittedTuple>& emitted, const std::string& component,
                                       const std::string& stream) {
  std::vector<std::vector<Value>> list;
  for (const EmittedTuple& tuple : emitted) {
    if (tuple.component == component && tuple.stream == stream) list.push_back(tuple.values);
  }
  return list;
}

}  // namespace

struct SimulatedTopology::Impl {
  Impl(const Topology& topology, Options given) : options(std::move(given)), start(clock.now()) {
    options.step = std::max(options.step, std::chrono::milliseconds(1));
    Topology fed = topology;
    for (const std::string& id : options.inputs) replace_spout(fed, id);
    RuntimeOptions runtime_options;
    runtime_options.threads = 0;
    runtime_options.clock = &clock;
    runtime_options.metrics = &metrics;
    runtime_options.message_timeout = options.message_timeout;
    runtime = std::make_unique<Runtime>(std::move(fed), runtime_options);
    for (const auto& [component, streams] : topology.streams) {
      if (!streams.empty()) watch(component);  // a tap on a component that emits nothing shows what it executes
    }
  }

  void replace_spout(Topology& topology, const std::string& id) {
    const auto spec = std::find_if(topology.components.begin(), topology.components.end(),
                                   [&](const ComponentSpec& c) { return c.id == id && c.spout; });
    if (spec == topology.components.end()) {
      throw TopologyError(id, "there is no spout \"" + id + "\" to give input to");
    }
    const auto feed = std::make_shared<Feed>(spec->tasks);
    spec->spout = [feed] { return std::make_unique<FedSpout>(feed); };
    feeds[id] = feed;
  }

  void watch(const std::string& component) {
    taps.push_back(runtime->tap(component, std::numeric_limits<double>::infinity(), [this](const Tuple& tuple, int) {
      EmittedTuple& seen = emitted.emplace_back();
      seen.component = tuple.source_component();
      seen.stream = tuple.source_stream();
      seen.task = tuple.source_task();
      seen.at = clock.now() - start;
      for (std::size_t i = 0; i < tuple.size(); ++i) seen.values.push_back(tuple.at(i));
    }));
  }

  Options options;
  SimulatedClock clock;
  const config::Clock::Instant start;
  config::Metrics metrics;
  std::vector<EmittedTuple> emitted;
  std::map<std::string, std::shared_ptr<Feed>> feeds;  ///< by spout
  std::unique_ptr<Runtime> runtime;
  std::vector<std::unique_ptr<Tap>> taps;
};

SimulatedTopology::SimulatedTopology(const Topology& topology, Options options)
    : impl_(std::make_unique<Impl>(topology, std::move(options))) {
  impl_->runtime->start();
  impl_->runtime->run_until_idle();
}

SimulatedTopology::~SimulatedTopology() {
  impl_->taps.clear();
  impl_->runtime->stop(std::chrono::milliseconds(0));
}

void SimulatedTopology::put(const std::string& spout, std::vector<Values> tuples) {
  const auto feed = impl_->feeds.find(spout);
  if (feed == impl_->feeds.end()) {
    throw std::invalid_argument("\"" + spout + "\" is not among the inputs of this simulation; name it there");
  }
  for (Values& values : tuples) feed->second->add(std::move(values));
  feed->second->wake();
  impl_->runtime->run_until_idle();
}

void SimulatedTopology::put(const std::string& spout, Values values) {
  std::vector<Values> one;
  one.push_back(std::move(values));
  put(spout, std::move(one));
}

void SimulatedTopology::advance(std::chrono::nanoseconds time) {
  const std::chrono::nanoseconds step = impl_->options.step;
  const std::chrono::nanoseconds end = this->time() + time;
  while (this->time() < end) {
    const std::chrono::nanoseconds to_next_step = step - this->time() % step;
    impl_->clock.advance(std::min(to_next_step, end - this->time()));
    impl_->runtime->run_due_timers();
    impl_->runtime->run_until_idle();
  }
}

std::chrono::nanoseconds SimulatedTopology::time() const {
  return impl_->clock.now() - impl_->start;
}

const std::vector<EmittedTuple>& SimulatedTopology::emitted() const {
  return impl_->emitted;
}

std::vector<std::vector<Value>> SimulatedTopology::tuples(const std::string& component,
                                                          const std::string& stream) const {
  return select(impl_->emitted, component, stream);
}

Snapshot SimulatedTopology::snapshot() const {
  return impl_->runtime->snapshot();
}

std::vector<std::vector<Value>> CompletedTopology::tuples(const std::string& component,
                                                          const std::string& stream) const {
  return select(emitted, component, stream);
}

CompletedTopology complete_topology(const Topology& topology, const CompleteOptions& options) {
  SimulatedTopology::Options simulation{{}, options.message_timeout, options.step};
  std::multimap<std::chrono::nanoseconds, std::pair<std::string, Values>> timed;
  for (const auto& [spout, inputs] : options.timed_inputs) {
    simulation.inputs.insert(spout);
    for (const TimedInput& input : inputs) timed.emplace(input.at, std::pair(spout, input.values));
  }
  for (const auto& [spout, inputs] : options.inputs) simulation.inputs.insert(spout);
  SimulatedTopology simulated(topology, std::move(simulation));
  for (const auto& [spout, inputs] : options.inputs) simulated.put(spout, inputs);
  for (auto& [at, input] : timed) {
    if (at > simulated.time()) simulated.advance(at - simulated.time());
    simulated.put(input.first, std::move(input.second));
  }
  simulated.advance(options.run_for);
  return {simulated.emitted(), simulated.snapshot()};
}

}  // namespace iotcloud::topology
