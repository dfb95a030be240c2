#include <array>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/control/protocol.h>

namespace iotcloud::gateway::protocol {

using nlohmann::json;

namespace {

constexpr std::array command_names = {"create", "activate", "deactivate", "remove", "shutdown", "ping", "metrics"};
constexpr std::array event_names = {"hello", "refused", "status", "pong", "metrics"};

template <typename Kind, typename Names>
Kind parse_kind(const json& body, const Names& names) {
  const auto name = body.at("kind").get<std::string>();
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (name == names[i]) return static_cast<Kind>(i);
  }
  throw config::Error(fmt::format("\"{}\" is no message between gateway and driver host", name));
}

json to_json(const InstanceSpec& spec) {
  json brokers = json::array();
  for (const auto& b : spec.brokers) {
    brokers.push_back({{"name", b.name},
                       {"type", b.type},
                       {"user", b.options.user},
                       {"password_file", b.options.password_file},
                       {"password_variable", b.options.password_variable},
                       {"ca", b.options.tls.ca_file},
                       {"certificate", b.options.tls.certificate_file},
                       {"key", b.options.tls.key_file},
                       {"properties", b.options.properties},
                       {"heartbeat_ms", b.options.heartbeat.count()},
                       {"own", b.exclusive_urls},
                       {"shared", b.shared_urls}});
  }
  // The order travels as it stands in the registry.
  return {{"order", discovery::encode(spec.order)}, {"brokers", brokers}};
}

InstanceSpec to_spec(const json& body) {
  InstanceSpec spec;
  spec.order = discovery::decode_order(body.at("order").get<std::string>(), "an order to a driver host");
  for (const auto& b : body.at("brokers")) {
    BrokerPlan plan{b.at("name"), b.at("type"), {}, b.at("own"), b.at("shared")};
    plan.options.user = b.at("user");
    plan.options.password_file = b.at("password_file");
    plan.options.password_variable = b.at("password_variable");
    plan.options.tls = {b.at("ca"), b.at("certificate"), b.at("key")};
    plan.options.properties = b.at("properties").get<std::map<std::string, std::string>>();
    plan.options.heartbeat = std::chrono::milliseconds(b.at("heartbeat_ms").get<std::int64_t>());
    spec.brokers.push_back(std::move(plan));
  }
  return spec;
}

json to_json(const discovery::ChannelRecord& c) {
  return {{"name", c.name},      {"transport", c.transport}, {"out", c.direction == discovery::Direction::out},
          {"url", c.broker_url}, {"gateway", c.gateway},     {"driver", c.driver},
          {"shared", c.shared},  {"instance", c.instance},   {"properties", c.properties}};
}

discovery::ChannelRecord to_channel(const json& body) {
  discovery::ChannelRecord c;
  c.name = body.at("name");
  c.transport = body.at("transport");
  c.direction = body.at("out").get<bool>() ? discovery::Direction::out : discovery::Direction::in;
  c.broker_url = body.at("url");
  c.gateway = body.at("gateway");
  c.driver = body.at("driver");
  c.instance = body.at("instance");
  c.shared = body.at("shared");
  c.properties = body.at("properties").get<std::map<std::string, std::string>>();
  return c;
}

json to_json(const InstanceStatus& s) {
  json channels = json::array();
  for (const auto& channel : s.channels) channels.push_back(to_json(channel));
  return {{"instance", s.instance}, {"driver", s.driver},     {"state", discovery::to_string(s.state)},
          {"reason", s.reason},     {"since_ms", s.since_ms}, {"channels", channels},
          {"metadata", s.metadata}};
}

InstanceStatus to_status(const json& body) {
  InstanceStatus s;
  s.instance = body.at("instance");
  s.driver = body.at("driver");
  s.state = discovery::parse_driver_state(body.at("state"));
  s.reason = body.at("reason");
  s.since_ms = body.at("since_ms");
  for (const auto& channel : body.at("channels")) s.channels.push_back(to_channel(channel));
  s.metadata = body.value("metadata", s.metadata);  // an older host says nothing of it
  return s;
}

json to_json(const Stall& s) {
  json body = {{"instance", s.instance}, {"own_thread", s.own_thread}, {"ms", s.time.count()}};
  if (s.limit) body["limit_ms"] = s.limit->count();
  return body;
}

Stall to_stall(const json& body) {
  Stall s{body.at("instance"), body.at("own_thread"), std::chrono::milliseconds(body.at("ms").get<std::int64_t>()), {}};
  if (body.contains("limit_ms")) s.limit = std::chrono::milliseconds(body.at("limit_ms").get<std::int64_t>());
  return s;
}

json to_json(const config::Sample& s) {
  json body = {{"name", s.name}, {"help", s.help}, {"labels", s.labels}, {"kind", static_cast<int>(s.kind)}};
  if (s.kind == config::Sample::Kind::histogram) {
    body["histogram"] = {s.histogram.count, s.histogram.mean_ns, s.histogram.p50_ns, s.histogram.p99_ns,
                         s.histogram.max_ns};
  } else {
    body["value"] = s.value;
  }
  return body;
}

config::Sample to_sample(const json& body) {
  config::Sample s;
  s.name = body.at("name");
  s.help = body.at("help");
  s.labels = body.at("labels").get<config::Labels>();
  const int kind = body.at("kind");
  if (kind < 0 || kind > static_cast<int>(config::Sample::Kind::histogram)) {
    throw config::Error(fmt::format("the metric {} is of an unknown kind", s.name));
  }
  s.kind = static_cast<config::Sample::Kind>(kind);
  const auto number = [](const json& value) {
    return value.is_null() ? 0.0 : value.get<double>();
  };  // null: not finite
  if (s.kind != config::Sample::Kind::histogram) {
    s.value = number(body.at("value"));
    return s;
  }
  const auto& h = body.at("histogram");
  s.histogram = {h.at(0), number(h.at(1)), number(h.at(2)), number(h.at(3)), number(h.at(4))};
  return s;
}

std::string frame(const json& body) {
  const std::string text = body.dump(-1, ' ', false, json::error_handler_t::replace);
  const auto size = static_cast<std::uint32_t>(text.size());
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>((size >> shift) & 0xff);
  return bytes + text;
}

/// JSON's own exceptions become ours.
template <typename Decode>
auto decoded(const std::string& body, Decode&& decode) {
  try {
    return decode(json::parse(body));
  } catch (const json::exception& e) {
    throw config::Error(fmt::format("a message between gateway and driver host cannot be read: {}", e.what()));
  }
}

}  // namespace

std::string encode(const Command& command) {
  json body = {{"kind", command_names[static_cast<std::size_t>(command.kind)]}};
  if (!command.instance.empty()) body["instance"] = command.instance;
  if (command.spec) body["spec"] = to_json(*command.spec);
  if (command.number != 0) body["number"] = command.number;
  return frame(body);
}

Command decode_command(const std::string& bytes) {
  return decoded(bytes, [](const json& body) {
    Command command;
    command.kind = parse_kind<Command::Kind>(body, command_names);
    command.instance = body.value("instance", "");
    if (body.contains("spec")) command.spec = to_spec(body.at("spec"));
    command.number = body.value("number", std::int64_t{0});
    if (command.kind == Command::Kind::create && !command.spec) throw config::Error("\"create\" without a spec");
    return command;
  });
}

std::string encode(const Event& event) {
  json body = {{"kind", event_names[static_cast<std::size_t>(event.kind)]}};
  switch (event.kind) {
    case Event::Kind::hello: {
      json instances = json::array();
      for (const auto& i : event.instances)
        instances.push_back({{"spec", to_json(i.spec)}, {"status", to_json(i.status)}});
      body.update({{"version", event.version},
                   {"plugin", event.order.plugin},
                   {"gateway", event.order.gateway},
                   {"isolated", event.order.isolated},
                   {"sha256", event.order.sha256},
                   {"found", {event.order.identity.sha256, event.order.identity.signed_by}},
                   {"instances", instances}});
      break;
    }
    case Event::Kind::refused:
      body["reason"] = event.reason;
      break;
    case Event::Kind::status:
      body["status"] = to_json(event.status);
      break;
    case Event::Kind::pong:
      body.update({{"number", event.number}, {"stalls", json::array()}});
      for (const auto& stall : event.stalls) body["stalls"].push_back(to_json(stall));
      break;
    case Event::Kind::metrics:
      body["samples"] = json::array();
      for (const auto& sample : event.samples) body["samples"].push_back(to_json(sample));
      break;
  }
  return frame(body);
}

Event decode_event(const std::string& bytes) {
  return decoded(bytes, [](const json& body) {
    Event event;
    event.kind = parse_kind<Event::Kind>(body, event_names);
    switch (event.kind) {
      case Event::Kind::hello:
        event.version = body.at("version");
        if (event.version != protocol::version) break;  // nothing else may be relied on
        event.order = {body.at("plugin"), body.at("gateway"), body.at("isolated"), {}, {}};
        event.order.sha256 = body.value("sha256", "");  // an older host says nothing of it
        if (body.contains("found")) event.order.identity = {body.at("found").at(0), body.at("found").at(1)};
        for (const auto& i : body.at("instances")) {
          event.instances.push_back({to_spec(i.at("spec")), to_status(i.at("status"))});
        }
        break;
      case Event::Kind::refused:
        event.reason = body.at("reason");
        break;
      case Event::Kind::status:
        event.status = to_status(body.at("status"));
        break;
      case Event::Kind::pong:
        event.number = body.at("number");
        for (const auto& stall : body.at("stalls")) event.stalls.push_back(to_stall(stall));
        break;
      case Event::Kind::metrics:
        for (const auto& sample : body.at("samples")) event.samples.push_back(to_sample(sample));
        break;
    }
    return event;
  });
}

std::optional<std::string> FrameReader::next() {
  constexpr std::size_t head = 4;
  if (buffer_.size() < head) return std::nullopt;
  std::size_t size = 0;
  for (std::size_t i = 0; i < head; ++i) size = (size << 8) | static_cast<unsigned char>(buffer_[i]);
  if (size > max_frame) throw config::Error(fmt::format("a frame of {} bytes; the limit is {}", size, max_frame));
  if (buffer_.size() < head + size) return std::nullopt;
  std::string body = buffer_.substr(head, size);
  buffer_.erase(0, head + size);
  return body;
}

}  // namespace iotcloud::gateway::protocol
