#include <algorithm>
#include <set>

#include <iotcloud/topology/definition/read_endpoint.h>

namespace iotcloud::topology::internal {

using config::Section;

namespace {

/// Reads `driver`, or the original system's `sensor`.
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
    if (!seen.insert(name).second) throw section.error("fields", "the field \"" + name + "\" is named twice");
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

/// Reads the expression that selects driver instances.
discovery::Selection read_where(Section& section) {
  const auto text = section.optional_string("where");
  if (!text) return {};
  try {
    return discovery::Selection::parse(*text);
  } catch (const discovery::SelectionError& error) {
    throw section.error_within("where", error.offset(), error.problem() + "\n" + error.pointer_lines());
  }
}

}  // namespace

std::string require_name(Section& section, const std::string& key) {
  const std::string name = section.require_string(key);
  const bool control = std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; });
  if (control || name == "." || name == ".." || name.find('/') != std::string::npos || name.size() > 200) {
    throw section.error(key, "\"" + name + "\" cannot be a name",
                        "1 to 200 characters without slash and control characters are expected");
  }
  return name;
}

void read_reading_options(Section& section, ReadingOptions& options) {
  auto properties = section.optional_section("properties");
  if (!properties) return;
  options.automatic_ack = properties->choice_or("ackMode", "manual", {"auto", "manual"}) == "auto";
  options.prefetch = static_cast<int>(properties->int_or("prefetchCount", options.prefetch, 1, 65535));
  options.requeue = properties->bool_or("requeue", options.requeue);
  options.max_tries = static_cast<int>(properties->int_or("maxTries", options.max_tries, 1, 1000));
  if (properties->optional_string("deadLetter")) options.dead_letter = require_name(*properties, "deadLetter");
  if (!options.dead_letter.empty() && options.automatic_ack) {
    throw properties->error("deadLetter", "with \"ackMode: auto\" the spout does not learn that a tuple failed",
                            "remove \"deadLetter\", or write \"ackMode: manual\"");
  }
  options.keep_last = static_cast<int>(properties->int_or("keepLast", options.keep_last, 0, 1'000'000));
  properties->finish();
}

void read_sending_options(Section& section, SendingOptions& options) {
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

EndpointDefinition read_endpoint(Section& section, const std::vector<std::string>& brokers) {
  EndpointDefinition endpoint;
  endpoint.broker = section.require_choice("broker", brokers);
  endpoint.driver = discovery::DriverName(require_driver(section));
  endpoint.channel = require_name(section, "channel");
  endpoint.where = read_where(section);
  endpoint.form =
      section.choice_or("builder", "bytes", {"bytes", "text"}) == "text" ? PayloadForm::text : PayloadForm::bytes;
  read_fields(section, endpoint);
  return endpoint;
}

}  // namespace iotcloud::topology::internal
