#include <algorithm>
#include <sstream>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/topology/definition/describe.h>

namespace iotcloud::topology {

namespace {

std::string text_of(std::chrono::microseconds time) {
  const auto us = time.count();
  if (us % 1'000'000 == 0) return std::to_string(us / 1'000'000) + " s";
  if (us % 1000 == 0) return std::to_string(us / 1000) + " ms";
  return std::to_string(us) + " us";
}

std::string count_of(std::size_t count, const std::string& thing) {
  return std::to_string(count) + " " + thing + (count == 1 ? "" : "s");
}

/// The component's definition; nullptr if the application of a component library made it.
const ComponentDefinition* find_definition(const TopologyDefinition& definition, const std::string& id) {
  for (const auto* group : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *group) {
      if (component.id == id) return &component;
    }
  }
  return nullptr;
}

/// Joins the lines of an expression.
std::string on_one_line(const std::string& text) {
  std::string line;
  std::istringstream words(text);
  for (std::string word; words >> word;) line += (line.empty() ? "" : " ") + word;
  return line;
}

std::string origin_of(const ComponentDefinition* definition, bool spout) {
  if (definition == nullptr) return "made by the application";
  if (!definition->endpoint) return "class " + definition->class_name;
  const EndpointDefinition& endpoint = *definition->endpoint;
  return std::string(spout ? "reads" : "sends to") + " channel \"" + endpoint.channel + "\" of driver \"" +
         endpoint.driver + "\"" + (endpoint.where.everything() ? "" : " where " + on_one_line(endpoint.where.text())) +
         ", broker \"" + endpoint.broker + "\"" +
         (endpoint.form == PayloadForm::built ? ", builder \"" + endpoint.builder + "\"" : "") +
         (endpoint.group.empty() ? "" : ", shared with all of group \"" + endpoint.group + "\"");
}

std::string describe_input(const InputSpec& input, const InputDefinition* definition) {
  std::string text = "  <- " + input.from;
  if (input.stream != default_stream) text += " stream \"" + input.stream + "\"";
  text += ", " + input.grouping;
  if (definition != nullptr && !definition->grouping_class.empty()) text += " " + definition->grouping_class;
  if (!input.fields.empty()) text += " (" + input.fields.list() + ")";
  if (input.deadline.count() > 0) text += ", deadline " + text_of(input.deadline);
  if (input.keep_last > 0) {
    const Fields& key = input.keep_key.empty() ? input.fields : input.keep_key;
    text += ", keeps the last " + (input.keep_last == 1 ? "" : std::to_string(input.keep_last) + " ") +
            (key.empty() ? "of all" : "of each (" + key.list() + ")");
  }
  return text + "\n";
}

/// Finds the definition of one of a bolt's inputs: the application's inputs come first, then those of the file, in
/// order.
const InputDefinition* find_input(const ComponentDefinition* definition, const ComponentSpec& spec, std::size_t i) {
  if (definition == nullptr) return nullptr;
  const std::size_t first = spec.inputs.size() - definition->inputs.size();
  return i < first ? nullptr : &definition->inputs[i - first];
}

std::string describe_component(const ComponentSpec& spec, const ComponentDefinition* definition,
                               const std::map<std::string, StreamSpec>& streams) {
  const bool spout = bool(spec.spout);
  std::string text =
      (spout ? "spout " : "bolt ") + spec.id + ": " + count_of(static_cast<std::size_t>(spec.parallelism), "executor") +
      ", " + count_of(static_cast<std::size_t>(spec.tasks), "task") + "; " + origin_of(definition, spout) + "\n";
  for (std::size_t i = 0; i < spec.inputs.size(); ++i) {
    text += describe_input(spec.inputs[i], find_input(definition, spec, i));
  }
  if (spec.deadline.count() > 0) text += "  deadline " + text_of(spec.deadline) + "\n";
  if (!spec.late_stream.empty()) text += "  late tuples go to stream \"" + spec.late_stream + "\"\n";
  if (spec.tick.count() > 0) text += "  ticks every " + text_of(spec.tick) + "\n";
  if (spec.max_spout_pending) {
    text += "  at most " +
            (*spec.max_spout_pending == 0 ? "any number of tuples" : count_of(*spec.max_spout_pending, "tuple")) +
            " under way for each task\n";
  }
  if (definition != nullptr && definition->endpoint && !definition->endpoint->reading.dead_letter.empty()) {
    text += "  messages that are given up go to topic \"" + definition->endpoint->reading.dead_letter + "\"\n";
  }
  if (definition != nullptr && definition->worker_scope) text += "  scope worker: each worker has its own\n";
  for (const auto& [name, stream] : streams) {
    text += "  -> " + (name == default_stream ? "" : "stream \"" + name + "\": ") + stream.fields.list() +
            (stream.direct ? " (direct)" : "") + "\n";
  }
  return text;
}

/// True if an input mixes tuples of several drivers: only tuples of one driver always reach the same worker.
bool crosses_workers(const InputSpec& input) {
  if (input.grouping == "global" || input.grouping == "all") return true;
  const bool keyed = input.grouping == "fields" || input.grouping == "partial_key";
  return keyed && !input.fields.find("driverID") && !input.fields.find("sensorID");
}

}  // namespace

std::string describe(const TopologyDefinition& definition, const Topology& topology) {
  std::string text = "topology " + topology.name + ": " + count_of(topology.components.size(), "component") + "\n";
  text += definition.registry.url.empty()
              ? "no registry is named: it runs in local mode only; \"zk.servers\" is for workers\n"
              : "registry " + brokers::printable_url(definition.registry.url) + ", drivers below " +
                    definition.zk_root + "\n";
  if (!definition.runtime.acking) text += "acking is off: messages whose tuples fail are lost\n";
  for (const auto& component : topology.components) {
    text += "\n" +
            describe_component(component, find_definition(definition, component.id), topology.streams.at(component.id));
  }
  const std::string crossed = crossings(definition, topology);
  if (crossed.empty()) return text;
  return text +
         "\nThese inputs reach across drivers, and each worker has only its own drivers' tuples: one worker alone may "
         "run this, unless \"scope: worker\" says that each worker processes its own tuples only:\n" +
         crossed;
}

std::string crossings(const TopologyDefinition& definition, const Topology& topology) {
  std::string text;
  if (definition.worker_scope) return text;
  for (const auto& component : topology.components) {
    const auto* written = find_definition(definition, component.id);
    if (written != nullptr && written->worker_scope) continue;
    for (const auto& input : component.inputs) {
      if (!crosses_workers(input)) continue;
      text += "  " + component.id + " <- " + input.from + ", " + input.grouping +
              (input.fields.empty() ? "" : " (" + input.fields.list() + ")") + "\n";
    }
  }
  return text;
}

}  // namespace iotcloud::topology
