#include <algorithm>
#include <memory>

#include <iotcloud/topology/runtime/complete_topology.h>

namespace iotcloud::topology {

namespace {

/// Reserved, so no component of a user has it.
constexpr const char* recorder_id = "__recorder";

/// Stands in for a spout: emits every task_count-th of the given tuples.
class FixedSpout final : public Spout {
 public:
  explicit FixedSpout(std::shared_ptr<const std::vector<Values>> input) : input_(std::move(input)) {}
  void declare_output_fields(OutputFieldsDeclarer&) const override {}
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    next_ = static_cast<std::size_t>(context.task_index);
    step_ = static_cast<std::size_t>(context.task_count);
  }
  bool next_tuple() override {
    if (next_ >= input_->size()) return false;
    const std::size_t at = std::exchange(next_, next_ + step_);
    collector_->emit((*input_)[at], at);
    return true;
  }

 private:
  std::shared_ptr<const std::vector<Values>> input_;
  SpoutOutputCollector* collector_ = nullptr;
  std::size_t next_ = 0, step_ = 1;
};

class Recorder final : public Bolt {
 public:
  explicit Recorder(std::vector<EmittedTuple>& emitted) : emitted_(emitted) {}
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void execute(const Tuple& tuple) override {
    EmittedTuple& seen = emitted_.emplace_back();
    seen.component = tuple.source_component();
    seen.stream = tuple.source_stream();
    seen.task = tuple.source_task();
    for (std::size_t i = 0; i < tuple.size(); ++i) seen.values.push_back(tuple.at(i));
    collector_->ack(tuple);
  }

 private:
  std::vector<EmittedTuple>& emitted_;
  OutputCollector* collector_ = nullptr;
};

void replace_spouts(Topology& topology, const CompleteOptions& options) {
  for (const auto& [id, tuples] : options.inputs) {
    const auto spec = std::find_if(topology.components.begin(), topology.components.end(),
                                   [&name = id](const ComponentSpec& c) { return c.id == name && c.spout; });
    if (spec == topology.components.end()) {
      throw TopologyError(id, "there is no spout \"" + id + "\" to give input to");
    }
    spec->spout = [input = std::make_shared<const std::vector<Values>>(tuples)] {
      return std::make_unique<FixedSpout>(input);
    };
  }
}

void add_recorder(Topology& topology, std::vector<EmittedTuple>& emitted) {
  ComponentSpec recorder;
  recorder.id = recorder_id;
  recorder.bolt = [&emitted] { return std::make_unique<Recorder>(emitted); };
  for (const auto& [component, streams] : topology.streams) {
    for (const auto& [stream, spec] : streams) {
      if (spec.direct) continue;
      Subscription& input = recorder.inputs.emplace_back();
      input.from = component;
      input.stream = stream;
      input.grouping = "global";
      input.factory = make_grouping("global");
    }
  }
  topology.components.push_back(std::move(recorder));
}

}  // namespace

std::vector<std::vector<Value>> CompletedTopology::tuples(const std::string& component,
                                                          const std::string& stream) const {
  std::vector<std::vector<Value>> list;
  for (const EmittedTuple& tuple : emitted) {
    if (tuple.component == component && tuple.stream == stream) list.push_back(tuple.values);
  }
  return list;
}

CompletedTopology complete_topology(const Topology& topology, const CompleteOptions& options) {
  CompletedTopology result;
  Topology observed = topology;
  replace_spouts(observed, options);
  add_recorder(observed, result.emitted);

  SimulatedClock clock;
  config::Metrics metrics;
  RuntimeOptions runtime_options;
  runtime_options.threads = 0;
  runtime_options.clock = &clock;
  runtime_options.metrics = &metrics;
  runtime_options.message_timeout = options.message_timeout;
  Runtime runtime(std::move(observed), runtime_options);
  runtime.start();
  runtime.run_until_idle();
  for (auto passed = options.step; passed <= options.run_for; passed += options.step) {
    clock.advance(options.step);
    runtime.run_due_timers();
    runtime.run_until_idle();
  }
  result.snapshot = runtime.snapshot();
  std::erase_if(result.snapshot.tasks, [](const TaskSnapshot& task) { return task.component == recorder_id; });
  runtime.stop(std::chrono::milliseconds(0));
  return result;
}

}  // namespace iotcloud::topology
