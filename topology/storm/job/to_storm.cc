#include <algorithm>
#include <chrono>
#include <memory>
#include <set>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include "iotcloud/topology/storm/storm_types.h"
#include <iotcloud/topology/storm/job/job.h>
#include <iotcloud/topology/storm/shim/component_source.h>
#include <iotcloud/topology/storm/shim/task_description.h>

namespace iotcloud::topology::storm {

namespace {

using Json = nlohmann::ordered_json;

idl::JavaObjectArg text(const std::string& value) {
  idl::JavaObjectArg argument;
  argument.__set_string_arg(value);
  return argument;
}

idl::JavaObjectArg number(std::int32_t value) {
  idl::JavaObjectArg argument;
  argument.__set_int_arg(value);
  return argument;
}

idl::JavaObject object(const std::string& name, std::vector<idl::JavaObjectArg> arguments) {
  idl::JavaObject made;
  made.full_class_name = "iotcloud.storm." + name;
  made.args_list = std::move(arguments);
  return made;
}

/// Bolts that send to brokers, whose fence compares a tuple's birth with the last standstill of their process.
std::set<std::string> sending_bolts(const TopologyDefinition& definition) {
  std::set<std::string> bolts;
  for (const auto& bolt : definition.bolts) {
    if (bolt.endpoint) bolts.insert(bolt.id);
  }
  return bolts;
}

/// The streams, as component and name, whose tuples say when they were born: those on the way to a deadline or a fence.
std::set<std::pair<std::string, std::string>> streams_with_births(const TopologyDefinition& definition,
                                                                  const Topology& topology) {
  const std::set<std::string> fenced = sending_bolts(definition);
  std::set<std::string> from;  // the components that need births to pass them on
  std::set<std::pair<std::string, std::string>> streams;
  for (auto component = topology.components.rbegin(); component != topology.components.rend(); ++component) {
    for (const InputSpec& input : component->inputs) {
      const bool own = component->deadline.count() > 0 || input.deadline.count() > 0 || fenced.contains(component->id);
      if (!own && !from.contains(component->id)) continue;
      streams.emplace(input.from, input.stream);
      from.insert(input.from);
    }
  }
  return streams;
}

idl::Grouping grouping_of(const ComponentSpec& bolt, std::size_t number_of_input) {
  const InputSpec& input = bolt.inputs[number_of_input];
  idl::Grouping grouping;
  if (input.grouping == "shuffle") {
    grouping.__set_shuffle({});
  } else if (input.grouping == "all") {
    grouping.__set_all({});
  } else if (input.grouping == "none") {
    grouping.__set_none({});
  } else if (input.grouping == "direct") {
    grouping.__set_direct({});
  } else if (input.grouping == "local_or_shuffle") {
    grouping.__set_local_or_shuffle({});
  } else if (input.grouping == "global") {
    grouping.__set_fields({});
  } else if (input.grouping == "fields") {
    grouping.__set_fields({input.fields.begin(), input.fields.end()});
  } else if (input.grouping == "partial_key") {
    std::string lines;
    for (const std::string& field : input.fields) lines += (lines.empty() ? "" : "\n") + field;
    grouping.__set_custom_object(object("PartialKey", {text(lines)}));
  } else {
    grouping.__set_custom_object(object(
        "CppGrouping", {text(topology_file), text(bolt.id), number(static_cast<std::int32_t>(number_of_input))}));
  }
  return grouping;
}

idl::ComponentCommon common_of(const Topology& topology, const ComponentSpec& component,
                               const std::set<std::pair<std::string, std::string>>& births) {
  idl::ComponentCommon common;
  for (std::size_t i = 0; i < component.inputs.size(); ++i) {
    idl::GlobalStreamId from;
    from.componentId = component.inputs[i].from;
    from.streamId = component.inputs[i].stream;
    common.inputs[from] = grouping_of(component, i);
  }
  for (const auto& [name, stream] : topology.streams.at(component.id)) {
    idl::StreamInfo info;
    info.output_fields.assign(stream.fields.begin(), stream.fields.end());
    if (births.contains({component.id, name})) info.output_fields.emplace_back(birth_field);
    info.direct = stream.direct;
    common.streams[name] = info;
  }
  Json conf = Json::object();
  conf["topology.tasks"] = component.tasks;
  if (component.max_spout_pending && *component.max_spout_pending > 0)
    conf["topology.max.spout.pending"] = *component.max_spout_pending;
  const auto tick = component.tick / std::chrono::seconds(1);
  if (tick > 0 && component.tick == std::chrono::seconds(tick)) conf["topology.tick.tuple.freq.secs"] = tick;
  common.__set_json_conf(conf.dump());
  common.__set_parallelism_hint(component.parallelism);
  return common;
}

std::string bytes_of(const idl::StormTopology& topology) {
  const auto memory = std::make_shared<apache::thrift::transport::TMemoryBuffer>();
  apache::thrift::protocol::TBinaryProtocol protocol(memory);
  topology.write(&protocol);
  return memory->getBufferAsString();
}

}  // namespace

std::string to_storm(const TopologyDefinition& definition, const Topology& topology) {
  const auto births = streams_with_births(definition, topology);
  idl::StormTopology storm;
  for (const ComponentSpec& component : topology.components) {
    idl::ComponentObject made;
    made.__set_java_object(object(component.spout ? "CppSpout" : "CppBolt", {text(topology_file)}));
    if (component.spout) {
      idl::SpoutSpec& spout = storm.spouts[component.id];
      spout.spout_object = made;
      spout.common = common_of(topology, component, births);
    } else {
      idl::Bolt& bolt = storm.bolts[component.id];
      bolt.bolt_object = made;
      bolt.common = common_of(topology, component, births);
    }
  }
  return bytes_of(storm);
}

}  // namespace iotcloud::topology::storm
