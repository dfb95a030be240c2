#include <algorithm>
#include <memory>

#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/storm/shim/task_description.h>

namespace iotcloud::topology::storm {

namespace {

using Json = nlohmann::json;

void read_stream(const Json& json, TaskDescription::Stream& stream) {
  stream.component = json.at("component");
  stream.stream = json.at("stream");
  auto names = json.at("fields").get<std::vector<std::string>>();
  if (!names.empty() && names.back() == birth_field) {
    stream.births = true;
    names.pop_back();
  }
  stream.fields = Fields(std::move(names));
}

TaskDescription read(const Json& json) {
  TaskDescription task;
  task.folder = json.at("folder");
  task.file = json.at("file");
  task.library = json.at("library");
  task.class_name = json.at("class");
  json.at("conf").get_to(task.conf);
  task.topology = json.at("topology");
  task.component = json.at("component");
  task.task = json.at("task");
  json.at("tasks").get_to(task.tasks);
  json.at("here").get_to(task.here);
  for (const Json& each : json.at("inputs")) {
    read_stream(each, task.inputs.emplace_back());
    task.inputs.back().key = Fields(each.at("key").get<std::vector<std::string>>());
  }
  for (const Json& each : json.at("outputs")) {
    auto& output = task.outputs.emplace_back();
    read_stream(each, output);
    output.direct = each.at("direct");
    each.at("targets").get_to(output.targets);
    output.parcels = each.at("parcels");
    each.at("told").get_to(output.told);
  }
  return task;
}

}  // namespace

TaskDescription TaskDescription::parse(std::string_view json) {
  try {
    return read(Json::parse(json));
  } catch (const Json::exception& error) {
    throw config::Error(std::string("the description of a Storm task cannot be read; are the jar's classes and its "
                                    "libiotcloud_storm.so of different builds? ") +
                        error.what());
  }
}

TopologyContext TaskDescription::context() const {
  TopologyContext context;
  context.topology = topology;
  context.component = component;
  context.task = task;
  const std::vector<int>& own = tasks.at(component);
  context.task_index = static_cast<int>(std::lower_bound(own.begin(), own.end(), task) - own.begin());
  context.task_count = static_cast<int>(own.size());
  context.tasks_of = std::make_shared<const std::map<std::string, std::vector<int>>>(tasks);
  for (const Input& input : inputs) {
    context.inputs.emplace_back(input.component, input.stream);
    context.input_keys.push_back(input.key);
  }
  return context;
}

}  // namespace iotcloud::topology::storm
