#include <algorithm>
#include <optional>
#include <set>
#include <tuple>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/number.h>
#include <iotcloud/topology/definition/connections.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/definition/read_endpoint.h>
#include <iotcloud/topology/grouping.h>

namespace iotcloud::topology {

namespace {

using config::YamlSection;
using internal::read_endpoint;
using internal::read_reading_options;
using internal::read_sending_options;
using internal::require_name;

constexpr int most_tasks = 10'000;

/// Reads the keys that spouts and bolts share.
ComponentDefinition read_component(const std::string& id, YamlSection section,
                                   const std::vector<std::string>& brokers) {
  ComponentDefinition component{.id = id,
                                .endpoint = {},
                                .class_name = {},
                                .conf = {},
                                .max_spout_pending = {},
                                .late_stream = {},
                                .inputs = {},
                                .section = section};
  component.class_name = section.string_or("class", "");
  if (component.class_name.empty()) {
    if (section.has("broker")) {
      component.endpoint = read_endpoint(section, brokers);
    } else {
      section.refuse("", "neither \"broker\" nor \"class\" is given",
                     "\"broker\", \"driver\", \"channel\" and \"fields\" for one that faces a broker, or "
                     "\"class\" for one of a component library");
    }
  } else if (section.has("broker")) {
    section.refuse("class", "a component that faces a broker has no class", "remove \"class\" or \"broker\"");
    component.endpoint = read_endpoint(section, brokers);
  }
  component.parallelism = static_cast<int>(section.int_or("parallelism", 1, 1, most_tasks));
  component.tasks = static_cast<int>(section.int_or("tasks", component.parallelism, 1, most_tasks));
  if (component.tasks < component.parallelism) {
    section.refuse("tasks",
                   std::to_string(component.tasks) + " tasks cannot keep the " + std::to_string(component.parallelism) +
                       " executors of \"parallelism\" busy",
                   "name as many tasks or more: parallelism can grow up to it while the topology runs");
  }
  component.conf = section.string_map("conf");
  if (component.endpoint && section.has("conf")) {
    section.refuse(
        "conf", "a component that faces a broker has none: nothing reads it",
        "write its keys beside \"broker\" (parallelism, stream, ...) or in \"properties\" (prefetchCount, ...)");
  }
  return component;
}

ComponentDefinition read_spout(const std::string& id, YamlSection section, const std::vector<std::string>& brokers) {
  auto spout = read_component(id, section, brokers);
  if (spout.endpoint) {
    read_reading_options(section, spout.endpoint->reading);
    spout.endpoint->stream = section.string_or("stream", default_stream);
    if (section.optional_string("group")) spout.endpoint->group = require_name(section, "group");
  }
  const auto pending = section.int_or("max_spout_pending", 0, 0, 1'000'000);
  if (section.has("max_spout_pending")) spout.max_spout_pending = static_cast<std::size_t>(pending);
  for (const char* key : {"tick", "deadline"}) {
    if (!section.has(key)) continue;
    section.refuse(key, "a spout has none: it executes no tuples", "set it on the bolts that its tuples go to");
  }
  section.finish();
  return spout;
}

void read_grouping(YamlSection& section, InputDefinition& input) {
  auto names = grouping_names();
  names.emplace_back("custom");
  input.grouping = section.choice_or("grouping", "shuffle", names);
  input.grouping_class = section.string_or("class", "");
  if (input.grouping == "custom" && input.grouping_class.empty()) {
    section.refuse("grouping", "a custom grouping is a class of a component library",
                   "add \"class: my.Grouping\", with the name that the library registers it by");
  }
  if (input.grouping != "custom" && !input.grouping_class.empty()) {
    section.refuse("class", "the grouping \"" + input.grouping + "\" has no class",
                   "remove \"class\", or write \"grouping: custom\"");
  }
  input.fields = Fields(section.strings_or("fields", {}));
  if (section.is_wrong("grouping")) return;
  const bool keyed = input.grouping == "fields" || input.grouping == "partial_key";
  if (keyed && input.fields.empty()) {
    section.refuse("grouping", "the grouping \"" + input.grouping + "\" needs a key",
                   "add \"fields: [driverID]\", for example");
  }
  if (!keyed && !input.fields.empty()) {
    section.refuse("fields", "the grouping \"" + input.grouping + "\" has no key",
                   "remove \"fields\", or write \"grouping: fields\"");
  }
}

InputDefinition read_input(YamlSection section) {
  InputDefinition input{.from = section.require_string("from"),
                        .stream = section.string_or("stream", default_stream),
                        .grouping = {},
                        .grouping_class = {},
                        .fields = {},
                        .keep_key = {},
                        .section = section};
  read_grouping(section, input);
  input.deadline = section.duration_or("deadline", input.deadline);
  input.keep_last = static_cast<std::size_t>(section.int_or("keep_last", 0, 0, 1'000'000));
  input.keep_key = Fields(section.strings_or("keep_key", {}));
  if (!input.keep_key.empty() && input.keep_last == 0) {
    section.refuse("keep_key", "this is the key of \"keep_last\", which is not given",
                   "add \"keep_last: 1\", for example, or remove \"keep_key\"");
  }
  section.finish();
  return input;
}

/// \pre the bolt's inputs are read.
void read_deadline(YamlSection& section, ComponentDefinition& bolt) {
  bolt.deadline = section.duration_or("deadline", bolt.deadline);
  bolt.late_stream = section.string_or("late_stream", "");
  if (bolt.late_stream.empty()) return;
  if (bolt.late_stream == default_stream) {
    section.refuse("late_stream", "late tuples need a stream of their own", "\"late_stream: late\", for example");
  }
  const bool input_deadline = std::any_of(bolt.inputs.begin(), bolt.inputs.end(),
                                          [](const InputDefinition& input) { return input.deadline.count() > 0; });
  if (bolt.deadline.count() == 0 && !input_deadline) {
    section.refuse("late_stream", "no tuple is late without a deadline",
                   "add \"deadline: 50ms\", for example, to the bolt or one of its inputs");
  }
}

ComponentDefinition read_bolt(const std::string& id, YamlSection section, const std::vector<std::string>& brokers) {
  auto bolt = read_component(id, section, brokers);
  if (bolt.endpoint) {
    read_sending_options(section, bolt.endpoint->sending);
    bolt.tick = std::chrono::seconds(1);  // BrokerBolt needs this tick
    if (!std::count(bolt.endpoint->roles.begin(), bolt.endpoint->roles.end(), FieldRole::driver_id)) {
      section.refuse("fields", "no field says which driver a tuple is for", "add \"driverID\"");
    }
    for (std::size_t i = 0; i < bolt.endpoint->roles.size(); ++i) {
      const FieldRole role = bolt.endpoint->roles[i];
      if (role != FieldRole::gateway_id && role != FieldRole::channel && role != FieldRole::redelivered) continue;
      section.refuse("fields", "a bolt does not send \"" + bolt.endpoint->fields[i] + "\"",
                     "remove it: a message gets its gateway and channel from the driver that it goes to");
    }
    if (section.has("tick")) {
      section.refuse("tick", "a bolt that sends to a broker ticks by itself", "remove \"tick\"");
    }
  } else {
    bolt.tick = section.duration_or("tick", bolt.tick);
  }
  for (const auto& input : section.section_list("inputs")) bolt.inputs.push_back(read_input(input));
  read_deadline(section, bolt);
  bolt.worker_scope = section.choice_or("scope", "", {"worker"}) == "worker";
  section.finish();
  return bolt;
}

PlacementSettings read_placement(YamlSection& runtime) {
  PlacementSettings settings;
  auto section = runtime.optional_section("placement");
  if (!section) return settings;
  constexpr int most = 1024;  // cores in a cpu_set_t
  for (const std::string& text : section->strings_or("cores", {})) {
    const auto core = config::parse_number<int>(text);
    if (!core || *core < 0 || *core >= most) {
      section->refuse("cores", "\"" + text + "\" is no core", "write numbers from 0, for example \"cores: [2, 3]\"");
      continue;
    }
    settings.cores.push_back(*core);
  }
  settings.priority = static_cast<int>(section->int_or("priority", settings.priority, 0, 99));
  settings.lock_memory = section->bool_or("lock_memory", settings.lock_memory);
  section->finish();
  return settings;
}

RunSettings read_runtime(YamlSection& root) {
  RunSettings settings;
  auto section = root.optional_section("runtime");
  if (!section) return settings;
  settings.threads = static_cast<int>(section->int_or("threads", settings.threads, 0, 1024));
  settings.message_timeout = std::chrono::duration_cast<std::chrono::milliseconds>(
      section->duration_or("message_timeout", settings.message_timeout));
  settings.acking = section->bool_or("acking", settings.acking);
  settings.max_spout_pending =
      static_cast<int>(section->int_or("max_spout_pending", settings.max_spout_pending, 0, 1'000'000));
  settings.mailbox_capacity =
      static_cast<int>(section->int_or("mailbox_capacity", settings.mailbox_capacity, 0, 1'000'000));
  settings.placement = read_placement(*section);
  section->finish();
  return settings;
}

/// Refuses brokers whose addresses the records name, in a fleet whose processes have users of their own: there whoever
/// has the user of one gateway writes that gateway's records, and is nobody else.
void refuse_addresses_of_records(const std::vector<ComponentDefinition>& components,
                                 const std::map<std::string, brokers::BrokerOptions>& brokers) {
  for (const auto& component : components) {
    if (!component.endpoint) continue;
    const std::string& name = component.endpoint->broker;
    const auto found = brokers.find(name);
    if (found != brokers.end() && !found->second.urls.empty()) continue;
    component.section.refuse("broker",
                             "\"" + name +
                                 "\" has no address in this file, so that messages would go to whatever address a "
                                 "channel's record names; with \"registry.users\" whoever has one gateway's user could "
                                 "name any",
                             "list the broker's own addresses: \"brokers: {" + name + ": {urls: [...]}}\"");
  }
}

/// The logical broker names that a topology may use: all kinds of brokers, the paper's own name (whatever serves it),
/// and the names in `brokers`.
std::vector<std::string> broker_names(const std::map<std::string, brokers::BrokerOptions>& brokers) {
  std::set<std::string> names(brokers::broker_kinds().begin(), brokers::broker_kinds().end());
  names.insert("rabbitmq");
  for (const auto& [name, options] : brokers) names.insert(name);
  return {names.begin(), names.end()};
}

/// Refuses two spouts of a topology on one channel: they would read the same queue and take each other's messages,
/// unless they are in different groups.
void refuse_double_readers(const std::vector<ComponentDefinition>& spouts) {
  std::map<std::tuple<discovery::DriverName, std::string, std::string>, std::string> readers;
  for (const auto& spout : spouts) {
    if (!spout.endpoint) continue;
    const EndpointDefinition& endpoint = *spout.endpoint;
    if (endpoint.driver.empty() || endpoint.channel.empty()) continue;  // their errors are said already
    const auto [first, fresh] =
        readers.emplace(std::tuple(endpoint.driver, endpoint.channel, endpoint.group), spout.id);
    if (!fresh) {
      throw spout.section.error("channel", "the spout \"" + first->second + "\" reads this driver's channel already",
                                "let both bolts take their input from one spout");
    }
  }
}

/// Whether the file says that this broker is a Kafka.
bool is_kafka(const std::string& broker, const std::map<std::string, brokers::BrokerOptions>& brokers) {
  const auto found = brokers.find(broker);
  if (found == brokers.end() || found->second.urls.empty()) return broker == "kafka";
  return found->second.urls.front().starts_with("kafka");
}

/// Refuses names of Kafka's groups with the mark that tells the groups of a topic's partitions apart: "a#1" is the
/// group of partition 1 of a topology "a".
void refuse_marks_in_groups(const TopologyDefinition& definition) {
  constexpr const char* problem = "\" has a \"#\", behind which Kafka's groups have the number of a partition";
  constexpr const char* help = "choose a name without it: another topology may have that group";
  for (const auto& spout : definition.spouts) {
    if (!spout.endpoint || !is_kafka(spout.endpoint->broker, definition.brokers)) continue;
    const std::string& group = spout.endpoint->group;
    if (group.find('#') != std::string::npos) throw spout.section.error("group", "\"" + group + problem, help);
    if (group.empty() && definition.name.str().find('#') != std::string::npos) {
      throw definition.root.error("topology.name", "\"" + definition.name.str() + problem, help);
    }
  }
}

}  // namespace

TopologyDefinition TopologyDefinition::read(YamlSection& root, const std::string& file) {
  TopologyDefinition definition{.file = file,
                                .name = {},
                                .registry = {},
                                .zk_root = {},
                                .order_keys = {},
                                .worker_scope = false,
                                .libraries = {},
                                .brokers = {},
                                .conf = {},
                                .runtime = {},
                                .storm = {},
                                .pages = {},
                                .spouts = {},
                                .bolts = {},
                                .root = root};
  definition.name = discovery::TopologyName(require_name(root, "topology.name"));
  definition.registry = read_registry(root);
  definition.zk_root = read_zk_root(root);
  definition.order_keys = root.strings_or("orders.trusted_keys", {});
  definition.worker_scope = root.choice_or("topology.scope", "", {"worker"}) == "worker";
  definition.libraries = root.strings_or("topology.library", {});
  definition.brokers = read_brokers(root, definition.registry.session_timeout);
  definition.conf = root.string_map("conf");
  definition.runtime = read_runtime(root);
  definition.storm = read_storm_settings(root);
  definition.pages = rpc::read_page_settings(root);
  config::read_log_settings(root);  // the daemons' frame applies them
  const auto names = broker_names(definition.brokers);
  for (auto& [id, section] : root.sections("spouts")) definition.spouts.push_back(read_spout(id, section, names));
  for (auto& [id, section] : root.sections("bolts")) definition.bolts.push_back(read_bolt(id, section, names));
  if (root.has("registry.users")) {
    refuse_addresses_of_records(definition.spouts, definition.brokers);
    refuse_addresses_of_records(definition.bolts, definition.brokers);
  }
  root.finish();
  refuse_double_readers(definition.spouts);
  refuse_marks_in_groups(definition);
  return definition;
}

Fields payload_fields(const EndpointDefinition& endpoint) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < endpoint.roles.size(); ++i) {
    if (endpoint.roles[i] == FieldRole::payload) names.push_back(endpoint.fields[i]);
  }
  return Fields(std::move(names));
}

const std::vector<std::string>& built_in_builders() {
  static const std::vector<std::string> names = {"bytes", "text", "json"};
  return names;
}

TopologyDefinition TopologyDefinition::load(const std::string& file) {
  std::optional<TopologyDefinition> definition;
  YamlSection::read_file(file, [&](YamlSection& top) { definition = read(top, file); });
  return *std::move(definition);
}

TopologyDefinition TopologyDefinition::parse(std::string_view text, const std::string& name) {
  std::optional<TopologyDefinition> definition;
  YamlSection::read_text(text, name, [&](YamlSection& top) { definition = read(top, name); });
  return *std::move(definition);
}

}  // namespace iotcloud::topology
