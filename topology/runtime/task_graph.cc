#include <algorithm>

#include <iotcloud/topology/runtime/task_graph.h>

namespace iotcloud::topology::internal {

namespace {

/// Runs user code during set-up, and turns what it throws into a TopologyError that names the component.
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

bool has_deadlines(const Topology& topology) {
  return std::any_of(topology.components.begin(), topology.components.end(), [](const ComponentSpec& spec) {
    return spec.deadline.count() > 0 || std::any_of(spec.inputs.begin(), spec.inputs.end(),
                                                    [](const InputSpec& input) { return input.deadline.count() > 0; });
  });
}

}  // namespace

TaskGraph::TaskGraph(const Topology& topology, TaskEnvironment environment, config::Metrics& metrics)
    : topology_(topology), environment_(environment), metrics_(metrics) {
  environment_.births = has_deadlines(topology) || environment_.options->births;
  name_tasks();
  for (const ComponentSpec& spec : topology_.components) make_tasks(spec);
  for (const auto& task : tasks_) {
    task->emitter().set_up(streams_of(*task), &bolts_, task.get());
  }
}

TaskGraph::~TaskGraph() {
  // Destroying a tuple that a bolt kept tells the spout's task that the tree was given up: do it while that task lives.
  for (BoltTask* bolt : bolts_) {
    if (bolt != nullptr) bolt->discard();
  }
}

const ComponentSpec& TaskGraph::spec_of(const Task& task) const {
  return *std::find_if(topology_.components.begin(), topology_.components.end(),
                       [&](const ComponentSpec& spec) { return spec.id == task.context().component; });
}

void TaskGraph::name_tasks() {
  int id = 0;
  auto tasks_of = std::make_shared<std::map<std::string, std::vector<int>>>();
  for (const ComponentSpec& spec : topology_.components) {
    for (int i = 0; i < spec.tasks; ++i) (*tasks_of)[spec.id].push_back(++id);
    executors_.try_emplace(spec.id, spec.parallelism, spec.tasks);
  }
  tasks_of_ = std::move(tasks_of);
  bolts_.resize(static_cast<std::size_t>(id) + 1, nullptr);
  for (const auto& [component, streams] : topology_.streams) {
    for (const auto& [stream, spec] : streams) {
      stream_infos_[{component, stream}] = detail::StreamInfo{component, stream, spec.fields};
    }
  }
}

TopologyContext TaskGraph::context_of(const ComponentSpec& spec, std::size_t index) const {
  TopologyContext context;
  context.topology = topology_.name;
  context.component = spec.id;
  context.task = tasks_of_->at(spec.id)[index];
  context.task_index = static_cast<int>(index);
  context.task_count = spec.tasks;
  context.tasks_of = tasks_of_;
  for (const InputSpec& input : spec.inputs) {
    std::pair source(input.from, input.stream);
    const Fields key = input.grouping == "fields" ? input.fields : Fields();
    const auto known = std::find(context.inputs.begin(), context.inputs.end(), source);
    if (known == context.inputs.end()) {
      context.inputs.push_back(std::move(source));
      context.input_keys.push_back(key);
    } else if (Fields& other = context.input_keys[static_cast<std::size_t>(known - context.inputs.begin())];
               other != key) {
      other = {};
    }
  }
  context.clock = environment_.clock;
  context.metrics = &metrics_;
  context.troubles = environment_.troubles;
  return context;
}

void TaskGraph::make_tasks(const ComponentSpec& spec) {
  for (std::size_t i = 0; i < static_cast<std::size_t>(spec.tasks); ++i) {
    TopologyContext context = context_of(spec, i);
    if (spec.spout) {
      auto spout = set_up(spec.id, "its factory", [&] { return spec.spout(); });
      auto gate = std::make_shared<WakeGate>();
      context.waker = SpoutWaker(gate);
      auto task = std::make_unique<SpoutTask>(environment_, executors_.at(spec.id), std::move(context),
                                              std::move(spout), std::move(gate),
                                              spec.max_spout_pending.value_or(environment_.options->max_spout_pending));
      spouts_.push_back(task.get());
      tasks_.push_back(std::move(task));
    } else {
      auto bolt = set_up(spec.id, "its factory", [&] { return spec.bolt(); });
      std::vector<const detail::StreamInfo*> inputs;
      for (const auto& input : context.inputs) inputs.push_back(&stream_infos_.at(input));
      auto task = std::make_unique<BoltTask>(environment_, executors_.at(spec.id), std::move(context), std::move(bolt),
                                             inputs, input_policies_of(spec), &tick_stream_);
      bolts_[static_cast<std::size_t>(task->id())] = task.get();
      tasks_.push_back(std::move(task));
    }
  }
}

InputPolicies TaskGraph::input_policies_of(const ComponentSpec& bolt) const {
  InputPolicies policies;
  policies.late_stream = bolt.late_stream;
  for (const InputSpec& input : bolt.inputs) {
    const auto* stream = &stream_infos_.at({input.from, input.stream});
    const auto shorter = bolt.deadline.count() == 0    ? input.deadline
                         : input.deadline.count() == 0 ? bolt.deadline
                                                       : std::min(bolt.deadline, input.deadline);
    if (shorter.count() > 0) policies.deadlines.push_back({stream, std::chrono::nanoseconds(shorter).count()});
    if (input.keep_last == 0) continue;
    KeepLast& keep = policies.keep_last.emplace_back();
    keep.stream = stream;
    keep.keep = input.keep_last;
    for (const std::string& name : input.keep_key.empty() ? input.fields : input.keep_key) {
      keep.key.push_back(stream->fields.find(name).value());  // build() checked that it is there
    }
  }
  return policies;
}

std::vector<OutStream> TaskGraph::streams_of(const Task& emitter) const {
  std::vector<OutStream> streams;
  const std::string& component = emitter.context().component;
  const auto declared = topology_.streams.find(component);
  if (declared == topology_.streams.end()) return streams;
  for (const auto& [stream, declaration] : declared->second) {
    const std::string& name = stream;
    const StreamSpec& spec = declaration;
    OutStream out{&stream_infos_.at({component, name}), spec.direct, {}};
    for (const ComponentSpec& reader : topology_.components) {
      for (const InputSpec& input : reader.inputs) {
        if (input.from != component || input.stream != name) continue;
        Edge edge{nullptr, &tasks_of_->at(reader.id), input.grouping == "custom"};
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

void TaskGraph::prepare(EmittingLane& lane) {
  try {
    for (auto task = tasks_.rbegin(); task != tasks_.rend(); ++task) {
      const std::string& id = (*task)->context().component;
      const ComponentSpec& spec = spec_of(**task);
      Config config = spec.config;
      config.insert(topology_.config.begin(), topology_.config.end());
      if ((*task)->is_spout()) {
        set_up(id, "open()", [&] { static_cast<SpoutTask&>(**task).open(config, lane); });
      } else {
        set_up(id, "prepare()", [&] { static_cast<BoltTask&>(**task).prepare(config, lane); });
      }
    }
  } catch (...) {
    for (const auto& task : tasks_) task->close();
    throw;
  }
}

}  // namespace iotcloud::topology::internal
