#include <algorithm>
#include <set>

#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

namespace {

/// Collects what one component declares.
class Declarations final : public OutputFieldsDeclarer {
 public:
  explicit Declarations(std::string component) : component_(std::move(component)) {}
  void declare_stream(const std::string& stream, Fields fields, bool direct) override {
    if (std::set<std::string>(fields.begin(), fields.end()).size() != fields.size()) {
      throw TopologyError(component_,
                          component_ + " declares stream \"" + stream + "\" with a field name twice: " + fields.list());
    }
    if (!streams.emplace(stream, StreamSpec{std::move(fields), direct}).second) {
      throw TopologyError(component_, component_ + " declares stream \"" + stream + "\" twice");
    }
  }
  std::map<std::string, StreamSpec> streams;

 private:
  std::string component_;
};

/// Asks a component for its streams, for how long it keeps tuples, and for its tick period if the topology sets none.
std::map<std::string, StreamSpec> declared(ComponentSpec& spec, const Config& topology_config) {
  Declarations declarations(spec.id);
  if (spec.spout) {
    spec.spout()->declare_output_fields(declarations);
    return declarations.streams;
  }
  const auto bolt = spec.bolt();
  bolt->declare_output_fields(declarations);
  Config config = spec.config;
  config.insert(topology_config.begin(), topology_config.end());
  const auto wished = bolt->tick_period(config);
  if (spec.tick.count() == 0) spec.tick = wished;
  spec.holds = bolt->holds_tuples_for(config);
  return declarations.streams;
}

std::string cannot_be_asked(const std::string& component, const std::exception& why) {
  return component + " could not be made and asked for its fields and ticks: " + why.what();
}

/// As declared(). \throws TopologyError only.
std::map<std::string, StreamSpec> ask(ComponentSpec& spec, const Config& topology_config) {
  try {
    return declared(spec, topology_config);
  } catch (const TopologyError&) {
    throw;
  } catch (const std::exception& e) {
    throw TopologyError(spec.id, cannot_be_asked(spec.id, e));
  }
}

void check_source(const ComponentSpec& bolt, const InputSpec& input, const Topology& topology) {
  if (topology.streams.contains(input.from)) return;
  std::string known;
  for (const auto& [id, streams] : topology.streams) known += (known.empty() ? "" : ", ") + id;
  throw TopologyError(bolt.id, bolt.id + " takes its input from \"" + input.from +
                                   "\", which is no component of this topology; there are: " + known);
}

/// Checks that the input's source exists and has the stream and fields.
void check_input(const ComponentSpec& bolt, const InputSpec& input, const Topology& topology) {
  const auto& streams = topology.streams.at(input.from);
  const auto stream = streams.find(input.stream);
  if (stream == streams.end()) {
    std::string known;
    for (const auto& [name, spec] : streams) known += (known.empty() ? "" : ", ") + name;
    throw TopologyError(bolt.id, bolt.id + " takes stream \"" + input.stream + "\" of " + input.from +
                                     ", which declares " + (known.empty() ? "no stream" : "only: " + known));
  }
  const bool direct = input.grouping == "direct";
  if (direct != stream->second.direct) {
    throw TopologyError(bolt.id,
                        bolt.id + ": stream \"" + input.stream + "\" of " + input.from +
                            (stream->second.direct ? " is direct and needs the direct grouping"
                                                   : " is not declared direct, so it cannot be grouped direct"));
  }
  if ((input.grouping == "fields" || input.grouping == "partial_key") && input.fields.empty()) {
    throw TopologyError(bolt.id, bolt.id + ": the " + input.grouping + " grouping on " + input.from +
                                     " needs the fields that are its key");
  }
  for (const auto& field : input.fields) {
    if (!stream->second.fields.find(field)) {
      throw TopologyError(bolt.id, bolt.id + ": the key field \"" + field + "\" is not declared by " + input.from +
                                       "; its fields are: " + stream->second.fields.list());
    }
  }
  for (const auto& field : input.keep_key) {
    if (!stream->second.fields.find(field)) {
      throw TopologyError(bolt.id, bolt.id + ": the key field \"" + field + "\" of keep_last is not declared by " +
                                       input.from + "; its fields are: " + stream->second.fields.list());
    }
  }
}

/// Sorts components so that sources come before the bolts that they feed. \throws TopologyError naming a cycle.
std::vector<ComponentSpec> sorted_by_flow(std::vector<ComponentSpec> components) {
  std::vector<ComponentSpec> sorted;
  std::set<std::string> done;
  while (!components.empty()) {
    const auto ready = std::find_if(components.begin(), components.end(), [&](const ComponentSpec& c) {
      return std::all_of(c.inputs.begin(), c.inputs.end(),
                         [&](const auto& input) { return done.contains(input.from); });
    });
    if (ready == components.end()) {
      // Every component that is left waits for an input that is left: walking back along such inputs for as many steps
      // as there are components meets one of them twice.
      std::vector<std::string> walk{components.front().id};
      while (true) {
        const auto at = std::find_if(components.begin(), components.end(),
                                     [&](const ComponentSpec& c) { return c.id == walk.back(); });
        const auto next = std::find_if(at->inputs.begin(), at->inputs.end(),
                                       [&](const auto& input) { return !done.contains(input.from); });
        const auto seen = std::find(walk.begin(), walk.end(), next->from);
        if (seen != walk.end()) {
          std::string cycle = next->from;
          for (auto it = walk.rbegin(); it != walk.rend() && *it != next->from; ++it) cycle += " -> " + *it;
          throw TopologyError(next->from, "the topology has a cycle: " + cycle + " -> " + next->from +
                                              "; tuples must flow one way, from spouts to bolts");
        }
        walk.push_back(next->from);
      }
    }
    done.insert(ready->id);
    sorted.push_back(std::move(*ready));
    components.erase(ready);
  }
  return sorted;
}

void set_tasks(ComponentSpec& spec, int count) {
  if (count < spec.parallelism) {
    throw TopologyError(spec.id, spec.id + ": " + std::to_string(count) + " tasks cannot keep " +
                                     std::to_string(spec.parallelism) +
                                     " executors busy; set at least as many tasks as executors");
  }
  spec.tasks = count;
}

InputSpec& last_input(ComponentSpec& spec) {
  if (spec.inputs.empty()) throw TopologyError(spec.id, spec.id + " has no input yet; add one first");
  return spec.inputs.back();
}

/// Declares the late stream with the fields of the inputs, because late tuples are emitted to it unchanged.
void declare_late_stream(const ComponentSpec& bolt, Topology& topology) {
  if (bolt.late_stream.empty()) return;
  const Fields& fields = topology.streams.at(bolt.inputs.front().from).at(bolt.inputs.front().stream).fields;
  for (const auto& input : bolt.inputs) {
    if (topology.streams.at(input.from).at(input.stream).fields == fields) continue;
    throw TopologyError(bolt.id, bolt.id + ": the late stream \"" + bolt.late_stream +
                                     "\" needs inputs of the same fields; " + input.from + " differs from " +
                                     bolt.inputs.front().from);
  }
  if (!topology.streams[bolt.id].emplace(bolt.late_stream, StreamSpec{fields, false}).second) {
    throw TopologyError(bolt.id, bolt.id + " declares stream \"" + bolt.late_stream +
                                     "\" itself; the late stream needs a name of its own");
  }
}

}  // namespace

BoltDeclarer& BoltDeclarer::grouping(const std::string& name, const std::string& from, Fields key,
                                     const std::string& stream) {
  GroupingFactory factory;
  try {
    factory = make_grouping(name, key);
  } catch (const std::invalid_argument& e) {
    throw TopologyError(spec_.id, spec_.id + ": " + e.what());
  }
  InputSpec input;
  input.from = from;
  input.stream = stream;
  input.grouping = name;
  input.fields = std::move(key);
  input.factory = std::move(factory);
  spec_.inputs.push_back(std::move(input));
  return *this;
}
BoltDeclarer& BoltDeclarer::shuffle_grouping(const std::string& from, const std::string& stream) {
  return grouping("shuffle", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::fields_grouping(const std::string& from, Fields key, const std::string& stream) {
  return grouping("fields", from, std::move(key), stream);
}
BoltDeclarer& BoltDeclarer::partial_key_grouping(const std::string& from, Fields key, const std::string& stream) {
  return grouping("partial_key", from, std::move(key), stream);
}
BoltDeclarer& BoltDeclarer::all_grouping(const std::string& from, const std::string& stream) {
  return grouping("all", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::global_grouping(const std::string& from, const std::string& stream) {
  return grouping("global", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::none_grouping(const std::string& from, const std::string& stream) {
  return grouping("none", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::local_or_shuffle_grouping(const std::string& from, const std::string& stream) {
  return grouping("local_or_shuffle", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::direct_grouping(const std::string& from, const std::string& stream) {
  return grouping("direct", from, {}, stream);
}
BoltDeclarer& BoltDeclarer::custom_grouping(const std::string& from, GroupingFactory factory,
                                            const std::string& stream) {
  InputSpec input;
  input.from = from;
  input.stream = stream;
  input.grouping = "custom";
  input.factory = std::move(factory);
  spec_.inputs.push_back(std::move(input));
  return *this;
}
BoltDeclarer& BoltDeclarer::tick(std::chrono::microseconds period) {
  spec_.tick = period;
  return *this;
}
BoltDeclarer& BoltDeclarer::tasks(int count) {
  set_tasks(spec_, count);
  return *this;
}
BoltDeclarer& BoltDeclarer::deadline(std::chrono::microseconds age, std::string late_stream) {
  spec_.deadline = age;
  spec_.late_stream = std::move(late_stream);
  return *this;
}
BoltDeclarer& BoltDeclarer::input_deadline(std::chrono::microseconds age) {
  last_input(spec_).deadline = age;
  return *this;
}
BoltDeclarer& BoltDeclarer::keep_last(std::size_t count, Fields key) {
  InputSpec& input = last_input(spec_);
  input.keep_last = count;
  input.keep_key = std::move(key);
  return *this;
}

SpoutDeclarer& SpoutDeclarer::tasks(int count) {
  set_tasks(spec_, count);
  return *this;
}
SpoutDeclarer& SpoutDeclarer::max_pending(std::size_t count) {
  spec_.max_spout_pending = count;
  return *this;
}

ComponentSpec& TopologyBuilder::add(const std::string& id, int parallelism, Config config) {
  if (id.empty() || id.starts_with("__")) {
    throw TopologyError(id, "\"" + id + "\" cannot be a component's id: it must not be empty nor begin with \"__\"");
  }
  if (has(id)) throw TopologyError(id, "there are two components with the id \"" + id + "\"");
  if (parallelism < 1) {
    throw TopologyError(id, id + ": parallelism " + std::to_string(parallelism) + " is not possible; 1 is the least");
  }
  components_.push_back(std::make_unique<ComponentSpec>());
  auto& spec = *components_.back();
  spec.id = id;
  spec.parallelism = spec.tasks = parallelism;
  spec.config = std::move(config);
  return spec;
}

SpoutDeclarer TopologyBuilder::set_spout(const std::string& id, SpoutFactory factory, int parallelism, Config config) {
  auto& spec = add(id, parallelism, std::move(config));
  spec.spout = std::move(factory);
  return SpoutDeclarer(spec);
}

BoltDeclarer TopologyBuilder::set_bolt(const std::string& id, BoltFactory factory, int parallelism, Config config) {
  auto& spec = add(id, parallelism, std::move(config));
  spec.bolt = std::move(factory);
  return BoltDeclarer(spec);
}

bool TopologyBuilder::has(const std::string& id) const {
  return std::any_of(components_.begin(), components_.end(), [&](const auto& c) { return c->id == id; });
}

BoltDeclarer TopologyBuilder::bolt(const std::string& id) {
  for (const auto& component : components_) {
    if (component->id == id && component->bolt) return BoltDeclarer(*component);
  }
  throw TopologyError(id, "there is no bolt \"" + id + "\" to connect");
}

std::vector<ComponentTrouble> TopologyBuilder::troubles(const Config& config) const {
  std::vector<ComponentTrouble> all;
  for (const auto& component : components_) {
    ComponentSpec spec = *component;
    try {
      static_cast<void>(declared(spec, config));
    } catch (const ConfErrors& errors) {
      for (const auto& [key, text] : errors.keys()) all.push_back({spec.id, key, text});
    } catch (const TopologyError& e) {
      all.push_back({spec.id, "", e.what()});
    } catch (const std::exception& e) {
      all.push_back({spec.id, "", cannot_be_asked(spec.id, e)});
    }
  }
  return all;
}

Topology TopologyBuilder::build(const std::string& name, const Config& config) const {
  Topology topology;
  topology.name = name;
  topology.config = config;
  std::vector<ComponentSpec> components;
  for (const auto& component : components_) {
    components.push_back(*component);
    topology.streams[component->id] = ask(components.back(), config);
  }
  if (std::none_of(components.begin(), components.end(), [](const auto& c) { return bool(c.spout); })) {
    throw TopologyError("",
                        "the topology \"" + name + "\" has no spout, so no tuple would ever be emitted; add a spout");
  }
  for (const auto& component : components) {
    if (!component.bolt) continue;
    if (component.inputs.empty()) {
      throw TopologyError(component.id, "bolt \"" + component.id + "\" has no input; say which component feeds it");
    }
    for (const auto& input : component.inputs) check_source(component, input, topology);
  }
  topology.components = sorted_by_flow(std::move(components));
  for (const auto& component : topology.components) {
    for (const auto& input : component.inputs) check_input(component, input, topology);
    if (component.bolt) declare_late_stream(component, topology);
  }
  return topology;
}

}  // namespace iotcloud::topology
