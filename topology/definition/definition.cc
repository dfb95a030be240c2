#include <algorithm>
#include <set>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/grouping.h>

namespace iotcloud::topology {

namespace {

using config::Section;

constexpr int most_tasks = 10'000;

/// A name that becomes part of registry paths and topics.
std::string require_name(Section& section, const std::string& key) {
  const std::string name = section.require_string(key);
  const bool control = std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; });
  if (control || name == "." || name == ".." || name.find('/') != std::string::npos || name.size() > 200) {
    throw section.error(key, "\"" + name + "\" cannot be a name",
                        "1 to 200 characters without slash and control characters are expected");
  }
  return name;
}

/// `driver`, or `sensor` as the original system says.
std::string require_driver(Section& section) {
  if (!section.has("driver") && section.has("sensor")) {
    static_cast<void>(section.optional_string("driver"));
    return require_name(section, "sensor");
  }
  if (section.has("sensor")) {
    throw section.error("sensor", "both \"driver\" and the older \"sensor\" are given", "remove \"sensor\"");
  }
  static_cast<void>(section.optional_string("sensor"));
  return require_name(section, "driver");
}

void read_fields(Section& section, EndpointDefinition& endpoint) {
  const auto names = section.require_strings("fields");
  std::set<std::string> seen;
  std::set<FieldRole> roles;
  for (const auto& name : names) {
    const FieldRole role = name == "driverID" || name == "sensorID" ? FieldRole::driver_id
                           : name == "time"                         ? FieldRole::time
                                                                    : FieldRole::payload;
    if (!seen.insert(name).second) throw section.error("fields", "the field \"" + name + "\" stands here twice");
    if (!roles.insert(role).second) {
      throw section.error("fields", "\"" + name + "\" is a second field of the same meaning",
                          "one field takes the message's payload, driverID and time its metadata: "
                          "[payload, driverID, time]");
    }
    endpoint.roles.push_back(role);
  }
  if (!roles.contains(FieldRole::payload)) {
    throw section.error("fields", "no field takes the message's payload",
                        "add one of any other name than driverID and time");
  }
  endpoint.fields = Fields(names);
}

void read_reading_options(Section& section, ReadingOptions& options) {
  auto properties = section.optional_section("properties");
  if (!properties) return;
  options.automatic_ack = properties->choice_or("ackMode", "manual", {"auto", "manual"}) == "auto";
  options.prefetch = static_cast<int>(properties->int_or("prefetchCount", options.prefetch, 1, 65535));
  options.requeue = properties->bool_or("requeue", options.requeue);
  options.max_tries = static_cast<int>(properties->int_or("maxTries", options.max_tries, 1, 1000));
  options.keep_last = static_cast<int>(properties->int_or("keepLast", options.keep_last, 0, 1'000'000));
  properties->finish();
}

void read_sending_options(Section& section, SendingOptions& options) {
  auto properties = section.optional_section("properties");
  if (!properties) return;
  options.keep_newest = properties->choice_or("whenFull", "block", {"keep_newest", "block"}) == "keep_newest";
  options.capacity = static_cast<int>(properties->int_or("capacity", options.capacity, 1, 1'000'000));
  options.deadline =
      std::chrono::duration_cast<std::chrono::milliseconds>(properties->duration_or("deadline", options.deadline));
  const bool fail = properties->choice_or("unknownDriver", "ack", {"ack", "fail"}) == "fail";
  options.unknown_driver = fail ? UnknownDriver::fail : UnknownDriver::ack;
  properties->finish();
}

EndpointDefinition read_endpoint(Section& section, const std::vector<std::string>& brokers) {
  EndpointDefinition endpoint;
  endpoint.broker = section.require_choice("broker", brokers);
  endpoint.driver = require_driver(section);
  endpoint.channel = require_name(section, "channel");
  endpoint.form =
      section.choice_or("builder", "bytes", {"bytes", "text"}) == "text" ? PayloadForm::text : PayloadForm::bytes;
  read_fields(section, endpoint);
  return endpoint;
}

/// What spouts and bolts have in common.
ComponentDefinition read_component(const std::string& id, Section section, const std::vector<std::string>& brokers) {
  ComponentDefinition component{id, std::nullopt, "", 1, {}, std::chrono::microseconds{0}, {}, section};
  component.class_name = section.string_or("class", "");
  if (component.class_name.empty()) {
    if (!section.has("broker")) {
      throw section.error("", "neither \"broker\" nor \"class\" is given",
                          "\"broker\", \"driver\", \"channel\" and \"fields\" for one that faces a broker, or "
                          "\"class\" for one of a component library");
    }
    component.endpoint = read_endpoint(section, brokers);
  } else if (section.has("broker")) {
    throw section.error("class", "a component that faces a broker has no class", "remove \"class\" or \"broker\"");
  }
  component.parallelism = static_cast<int>(section.int_or("parallelism", 1, 1, most_tasks));
  component.conf = section.string_map("conf");
  return component;
}

ComponentDefinition read_spout(const std::string& id, Section section, const std::vector<std::string>& brokers) {
  auto spout = read_component(id, section, brokers);
  if (spout.endpoint) {
    read_reading_options(section, spout.endpoint->reading);
    spout.endpoint->stream = section.string_or("stream", default_stream);
  }
  section.finish();
  return spout;
}

ComponentDefinition read_bolt(const std::string& id, Section section, const std::vector<std::string>& brokers) {
  auto bolt = read_component(id, section, brokers);
  if (bolt.endpoint) {
    read_sending_options(section, bolt.endpoint->sending);
    bolt.tick = std::chrono::seconds(1);  // its own, see BrokerBolt
    if (!std::count(bolt.endpoint->roles.begin(), bolt.endpoint->roles.end(), FieldRole::driver_id)) {
      throw section.error("fields", "no field says which driver a tuple is for", "add \"driverID\"");
    }
  } else {
    bolt.tick = section.duration_or("tick", bolt.tick);
  }
  for (auto& input : section.section_list("inputs")) {
    InputDefinition definition{input.require_string("from"), input.string_or("stream", default_stream),
                               input.choice_or("grouping", "shuffle", grouping_names()),
                               Fields(input.strings_or("fields", {})), input};
    const bool keyed = definition.grouping == "fields" || definition.grouping == "partial_key";
    if (keyed && definition.fields.empty()) {
      throw input.error("grouping", "the grouping \"" + definition.grouping + "\" needs a key",
                        "add \"fields: [driverID]\", say");
    }
    if (!keyed && !definition.fields.empty()) {
      throw input.error("fields", "the grouping \"" + definition.grouping + "\" has no key",
                        "remove \"fields\", or write \"grouping: fields\"");
    }
    input.finish();
    bolt.inputs.push_back(std::move(definition));
  }
  section.finish();
  return bolt;
}

/// zk.servers as a registry's URL; `registry` goes before it.
std::string read_registry(Section& root) {
  const auto servers = root.strings_or("zk.servers", {});
  const auto registry = root.string_or("registry", "");
  if (!registry.empty() || servers.empty()) return registry;
  std::string url = "zookeeper://";
  for (const auto& server : servers) {
    const auto colon = server.rfind(':');
    if (colon == std::string::npos || colon == 0 || colon + 1 == server.size()) {
      throw root.error("zk.servers", "\"" + server + "\" is not a server", "host:port is expected (2181 is usual)");
    }
    url += (url.back() == '/' ? "" : ",") + server;
  }
  return url;
}

RunSettings read_runtime(Section& root) {
  RunSettings settings;
  auto section = root.optional_section("runtime");
  if (!section) return settings;
  settings.threads = static_cast<int>(section->int_or("threads", settings.threads, 0, 1024));
  settings.message_timeout = std::chrono::duration_cast<std::chrono::milliseconds>(
      section->duration_or("message_timeout", settings.message_timeout));
  settings.max_spout_pending =
      static_cast<int>(section->int_or("max_spout_pending", settings.max_spout_pending, 0, 1'000'000));
  settings.mailbox_capacity =
      static_cast<int>(section->int_or("mailbox_capacity", settings.mailbox_capacity, 0, 1'000'000));
  section->finish();
  return settings;
}

/// The logical broker names that a topology may use: the kinds there are, the paper's own name (whatever serves it),
/// and those that `brokers` names.
std::vector<std::string> broker_names(const std::map<std::string, std::string>& brokers) {
  std::set<std::string> names(brokers::broker_kinds().begin(), brokers::broker_kinds().end());
  names.insert("rabbitmq");
  for (const auto& [name, url] : brokers) names.insert(name);
  return {names.begin(), names.end()};
}

/// Two spouts of a topology on one channel would take each other's messages: they read the same queue.
void refuse_double_readers(const std::vector<ComponentDefinition>& spouts) {
  std::map<std::pair<std::string, std::string>, std::string> readers;
  for (const auto& spout : spouts) {
    if (!spout.endpoint) continue;
    const auto [first, fresh] = readers.emplace(std::pair(spout.endpoint->driver, spout.endpoint->channel), spout.id);
    if (!fresh) {
      throw spout.section.error("channel", "the spout \"" + first->second + "\" reads this driver's channel already",
                                "let both bolts take their input from one spout");
    }
  }
}

TopologyDefinition read(Section root, const std::string& file) {
  TopologyDefinition definition{.file = file,
                                .name = {},
                                .registry_url = {},
                                .zk_root = {},
                                .libraries = {},
                                .brokers = {},
                                .conf = {},
                                .runtime = {},
                                .metrics_address = {},
                                .spouts = {},
                                .bolts = {},
                                .root = root};
  definition.name = require_name(root, "topology.name");
  definition.registry_url = read_registry(root);
  definition.zk_root = root.string_or("zk.root", "/iot/sensors");
  if (definition.zk_root.size() < 2 || definition.zk_root.front() != '/' || definition.zk_root.back() == '/') {
    throw root.error("zk.root", "\"" + definition.zk_root + "\" is not a path", "/iot/sensors is usual");
  }
  definition.libraries = root.strings_or("topology.library", {});
  definition.brokers = root.string_map("brokers");
  definition.conf = root.string_map("conf");
  definition.runtime = read_runtime(root);
  if (auto metrics = root.optional_section("metrics")) {
    definition.metrics_address = metrics->require_string("address");
    metrics->finish();
  }
  const auto names = broker_names(definition.brokers);
  for (auto& [id, section] : root.sections("spouts")) definition.spouts.push_back(read_spout(id, section, names));
  for (auto& [id, section] : root.sections("bolts")) definition.bolts.push_back(read_bolt(id, section, names));
  root.finish();
  refuse_double_readers(definition.spouts);
  return definition;
}

}  // namespace

TopologyDefinition TopologyDefinition::load(const std::string& file) {
  return read(Section::load_file(file), file);
}

TopologyDefinition TopologyDefinition::parse(std::string_view text, const std::string& name) {
  return read(Section::parse(text, name), name);
}

}  // namespace iotcloud::topology
