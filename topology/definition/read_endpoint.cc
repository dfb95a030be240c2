#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <iotcloud/brokers/metadata_names.h>
#include <iotcloud/topology/definition/read_endpoint.h>

namespace iotcloud::topology::internal {

using config::YamlSection;

namespace {

/// Reads `driver`, or the original system's `sensor`.
std::string require_driver(YamlSection& section) {
  if (!section.has("driver") && section.has("sensor")) {
    static_cast<void>(section.optional_string("driver"));
    return require_name(section, "sensor");
  }
  if (section.has("sensor")) {
    section.refuse("sensor", "both \"driver\" and the older \"sensor\" are given", "remove \"sensor\"");
  }
  static_cast<void>(section.optional_string("sensor"));
  return require_name(section, "driver");
}

FieldRole role_of(const std::string& name) {
  static const std::map<std::string, FieldRole> roles = {
      {"driverID", FieldRole::driver_id},     {"sensorID", FieldRole::driver_id}, {"time", FieldRole::time},
      {"gatewayID", FieldRole::gateway_id},   {"siteID", FieldRole::gateway_id},  {"channel", FieldRole::channel},
      {"redelivered", FieldRole::redelivered}};
  const auto found = roles.find(name);
  return found == roles.end() ? FieldRole::payload : found->second;
}

/// Refuses names under which messages carry other metadata (docs/wire.md#message-metadata).
void check_property(const YamlSection& mapping, const std::string& property) {
  if (brokers::metadata::is_original(property)) {
    mapping.refuse("property", "\"" + property + "\" is no custom property but metadata of every message",
                   "use the field driverID, gatewayID or time");
  }
  if (property.starts_with("x-iotcloud-") || property.starts_with("iotcloud_")) {
    mapping.refuse("property", "names that begin with \"x-iotcloud-\" or \"iotcloud_\" are the system's own");
  }
}

/// One item of `fields`.
struct Field {
  std::string name;
  FieldRole role;
  std::string property;
};

Field read_field(YamlSection::Item& item) {
  if (!item.mapping) return {item.text, role_of(item.text), ""};
  YamlSection& mapping = *item.mapping;
  const std::string property = mapping.require_string("property");
  check_property(mapping, property);
  std::string name = mapping.string_or("as", property);
  mapping.finish();
  if (role_of(name) == FieldRole::driver_id || role_of(name) == FieldRole::time) {
    mapping.refuse("as", "\"" + name + "\" is a field of another meaning", "choose another name for this one");
  }
  return {std::move(name), FieldRole::property, property};
}

constexpr const char* field_words =
    "driverID, time, gatewayID, channel, redelivered and {property: NAME} are metadata, any other name is the payload: "
    "[payload, driverID, time]";

void read_fields(YamlSection& section, EndpointDefinition& endpoint) {
  std::vector<std::string> names;
  std::set<FieldRole> roles;
  for (auto& item : section.require_items("fields")) {
    const auto [name, role, property] = read_field(item);
    if (std::find(names.begin(), names.end(), name) != names.end()) {
      section.refuse("fields", "the field \"" + name + "\" is named twice");
      continue;
    }
    const bool several =
        role == FieldRole::property || (role == FieldRole::payload && endpoint.form == PayloadForm::built);
    if (!roles.insert(role).second && !several) {
      section.refuse("fields", "\"" + name + "\" is a second field of the same meaning", field_words);
    }
    names.push_back(name);
    endpoint.roles.push_back(role);
    endpoint.properties.push_back(property);
  }
  if (!roles.contains(FieldRole::payload)) {
    section.refuse("fields", "no field takes the message's payload", field_words);
  }
  endpoint.fields = Fields(std::move(names));
}

/// Reads the expression that selects driver instances.
discovery::Selection read_where(YamlSection& section) {
  const auto text = section.optional_string("where");
  if (!text) return {};
  try {
    return discovery::Selection::parse(*text);
  } catch (const discovery::SelectionError& error) {
    section.refuse(section.error_within("where", error.offset(), error.problem() + "\n" + error.pointer_lines()));
    return {};
  }
}

}  // namespace

std::string require_name(YamlSection& section, const std::string& key) {
  std::string name = section.require_string(key);
  const bool control = std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; });
  if (control || name == "." || name == ".." || name.find('/') != std::string::npos || name.size() > 200) {
    section.refuse(key, "\"" + name + "\" cannot be a name",
                   "1 to 200 characters without slash and control characters are expected");
  }
  return name;
}

void read_reading_options(YamlSection& section, ReadingOptions& options) {
  auto properties = section.optional_section("properties");
  if (!properties) return;
  options.automatic_ack = properties->choice_or("ackMode", "manual", {"auto", "manual"}) == "auto";
  options.prefetch = static_cast<int>(properties->int_or("prefetchCount", options.prefetch, 1, 65535));
  options.own_prefetch = properties->has("prefetchCount");
  options.requeue = properties->bool_or("requeue", options.requeue);
  options.max_tries = static_cast<int>(properties->int_or("maxTries", options.max_tries, 1, 1000));
  if (properties->optional_string("deadLetter")) options.dead_letter = require_name(*properties, "deadLetter");
  if (!options.dead_letter.empty() && options.automatic_ack) {
    properties->refuse("deadLetter", "with \"ackMode: auto\" the spout does not learn that a tuple failed",
                       "remove \"deadLetter\", or write \"ackMode: manual\"");
  }
  options.keep_last = static_cast<int>(properties->int_or("keepLast", options.keep_last, 0, 1'000'000));
  properties->finish();
}

void read_sending_options(YamlSection& section, SendingOptions& options) {
  auto properties = section.optional_section("properties");
  if (!properties) return;
  options.keep_newest = properties->choice_or("whenFull", "block", {"keep_newest", "block"}) == "keep_newest";
  const std::string ack_when =
      properties->choice_or("ackWhen", options.keep_newest ? "accepted" : "confirmed", {"confirmed", "accepted"});
  options.ack_when = ack_when == "accepted" ? AckWhen::accepted : AckWhen::confirmed;
  options.capacity = static_cast<int>(properties->int_or("capacity", options.capacity, 1, 1'000'000));
  options.deadline =
      std::chrono::duration_cast<std::chrono::milliseconds>(properties->duration_or("deadline", options.deadline));
  const bool fail = properties->choice_or("unknownDriver", "ack", {"ack", "fail"}) == "fail";
  options.unknown_driver = fail ? UnknownDriver::fail : UnknownDriver::ack;
  properties->finish();
}

EndpointDefinition read_endpoint(YamlSection& section, const std::vector<std::string>& brokers) {
  EndpointDefinition endpoint;
  endpoint.broker = section.require_choice("broker", brokers);
  endpoint.driver = discovery::DriverName(require_driver(section));
  endpoint.channel = require_name(section, "channel");
  endpoint.where = read_where(section);
  endpoint.builder = section.string_or("builder", endpoint.builder);
  endpoint.form = endpoint.builder == "bytes"  ? PayloadForm::bytes
                  : endpoint.builder == "text" ? PayloadForm::text
                                               : PayloadForm::built;
  read_fields(section, endpoint);
  return endpoint;
}

}  // namespace iotcloud::topology::internal
