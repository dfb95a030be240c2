#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <string_view>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/frames.h>

namespace iotcloud::gateway::protocol {

using discovery::from_json;
using discovery::to_json;
using nlohmann::json;

namespace {

constexpr std::array command_names = {"create",  "activate", "deactivate", "remove", "shutdown", "ping",
                                      "metrics", "deliver",  "answer",     "renew",  "ask",      "prove"};
constexpr std::array report_names = {"hello", "refused", "status", "pong", "metrics", "pass", "answer", "told"};
constexpr std::array answer_names = {"handled", "failed", "comes", "nowhere"};

template <typename Kind, typename Names>
Kind parse_kind(const json& body, const Names& names) {
  const auto name = body.at("kind").get<std::string>();
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (name == names[i]) return static_cast<Kind>(i);
  }
  throw config::Error(fmt::format("\"{}\" is no message between gateway and driver host", name));
}

/// The source of an unreadable message, for the error text.
constexpr const char* between = "between gateway and driver host";

json spec_json(const InstanceSpec& spec) {
  auto body = to_json<json>(spec);
  body["order"] = discovery::encode(spec.order);
  return body;
}

InstanceSpec spec_of(const json& body) {
  auto spec = from_json<InstanceSpec>(body, between);
  spec.order = discovery::decode_order(body.at("order").get<std::string>(), "an order to a driver host");
  return spec;
}

template <typename Item>
std::vector<Item> list_of(const json& body) {
  std::vector<Item> items;
  for (const auto& item : body) items.push_back(from_json<Item>(item, between));
  return items;
}

json sample_json(const config::Sample& s) {
  json body = {{"name", s.name}, {"help", s.help}, {"labels", s.labels}, {"kind", static_cast<int>(s.kind)}};
  if (s.kind == config::Sample::Kind::histogram) {
    body["histogram"] = {s.histogram.count, s.histogram.mean_ns, s.histogram.p50_ns, s.histogram.p99_ns,
                         s.histogram.max_ns};
  } else {
    body["value"] = s.value;
  }
  return body;
}

config::Sample sample_of(const json& body) {
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
  };  // JSON writes a number that is not finite as null
  if (s.kind != config::Sample::Kind::histogram) {
    s.value = number(body.at("value"));
    return s;
  }
  const auto& h = body.at("histogram");
  s.histogram = {h.at(0), number(h.at(1)), number(h.at(2)), number(h.at(3)), number(h.at(4))};
  return s;
}

constexpr std::string_view digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Bytes in base64: four characters for three bytes, whatever the bytes are. JSON writes some characters as six.
std::string text_of(std::string_view bytes) {
  std::string text((bytes.size() + 2) / 3 * 4, '=');
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t here = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      group = group << 8U | (k < here ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k <= here; ++k) text[i / 3 * 4 + k] = digits[group >> (18U - 6U * k) & 0x3FU];
  }
  return text;
}

/// The value of each character in base64; 255: it is none.
constexpr std::array<std::uint8_t, 256> values_of_digits() {
  std::array<std::uint8_t, 256> values{};
  values.fill(255);
  for (std::size_t i = 0; i < digits.size(); ++i) {
    values[static_cast<unsigned char>(digits[i])] = static_cast<std::uint8_t>(i);
  }
  return values;
}

/// \throws config::Error for a text that text_of() does not make.
std::string bytes_of(const std::string& text) {
  static constexpr auto values = values_of_digits();
  std::size_t end = text.size();
  for (int padding = 0; padding < 2 && end > 0 && text[end - 1] == '='; ++padding) --end;
  std::string bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t group = 0;
  bool readable = text.size() % 4 == 0;
  for (std::size_t i = 0; i < end && readable; ++i) {
    const auto value = values[static_cast<unsigned char>(text[i])];
    readable = value != 255;
    group = group << 6U | value;
    if (i % 4 != 0) bytes.push_back(static_cast<char>(group >> (6U - 2U * (i % 4)) & 0xFFU));
  }
  if (!readable) throw config::Error("a passed message has a part that is not base64");
  return bytes;
}

json passed_json(const PassedMessage& passed) {
  json properties = json::array();
  for (const auto& [key, value] : passed.message.properties) properties.push_back({text_of(key), text_of(value)});
  return {{"number", passed.number},
          {"topic", text_of(passed.topic)},
          {"instance", text_of(passed.message.driver_id)},
          {"gateway", text_of(passed.message.gateway_id)},
          {"time", passed.message.time_ms},
          {"properties", properties},
          {"payload", text_of(passed.message.payload.text())}};
}

PassedMessage passed_of(const json& body) {
  PassedMessage passed;
  passed.number = body.at("number");
  passed.topic = bytes_of(body.at("topic"));
  passed.message.driver_id = bytes_of(body.at("instance"));
  passed.message.gateway_id = bytes_of(body.at("gateway"));
  passed.message.time_ms = body.at("time");
  for (const auto& pair : body.at("properties")) {
    passed.message.properties.set(bytes_of(pair.at(0)), bytes_of(pair.at(1)));
  }
  passed.message.payload = brokers::Payload::take(bytes_of(body.at("payload")));
  return passed;
}

using ByteMap = std::map<std::string, std::string>;

ByteMap map_text(const ByteMap& bytes) {
  ByteMap text;
  for (const auto& [key, value] : bytes) text[text_of(key)] = text_of(value);
  return text;
}

ByteMap map_bytes(const ByteMap& text) {
  ByteMap bytes;
  for (const auto& [key, value] : text) bytes[bytes_of(key)] = bytes_of(value);
  return bytes;
}

json look_json(discovery::ChannelLook look) {
  for (auto& message : look.messages) {
    message.payload = text_of(message.payload);
    message.properties = map_text(message.properties);
  }
  return to_json<json>(look);
}

discovery::ChannelLook look_of(const json& body) {
  auto look = from_json<discovery::ChannelLook>(body, between);
  for (auto& message : look.messages) {
    message.payload = bytes_of(message.payload);
    message.properties = map_bytes(message.properties);
  }
  return look;
}

PassAnswer answer_of(const json& body) {
  const auto name = body.at("answer").get<std::string>();
  for (std::size_t i = 0; i < answer_names.size(); ++i) {
    if (name == answer_names[i]) return static_cast<PassAnswer>(i);
  }
  throw config::Error(fmt::format("\"{}\" is no answer to a passed message", name));
}

std::string frame(const json& body) {
  return processes::frame(body.dump(-1, ' ', false, json::error_handler_t::replace));
}

/// Turns exceptions of the JSON library into config::Error. A host with a broken plugin may send anything: the
/// levels of lists and objects within each other are limited, as in what comes from the registry.
template <typename Decode>
auto decoded(const std::string& body, Decode&& decode) {
  try {
    return decode(discovery::parse_json(body, std::string("a message ") + between, processes::max_frame));
  } catch (const json::exception& e) {
    throw config::Error(fmt::format("a message between gateway and driver host cannot be read: {}", e.what()));
  }
}

}  // namespace

std::string encode(const HostCommand& command) {
  json body = {{"kind", command_names[static_cast<std::size_t>(command.kind)]}};
  if (!command.instance.empty()) body["instance"] = command.instance;
  if (command.spec) body["spec"] = spec_json(*command.spec);
  if (command.number != 0) body["number"] = command.number;
  if (command.kind == HostCommand::Kind::deliver) body["passed"] = passed_json(command.passed);
  if (command.kind == HostCommand::Kind::answer) {
    body["answer"] = answer_names[static_cast<std::size_t>(command.answer)];
  }
  if (command.kind == HostCommand::Kind::ask) {
    body["question"] = to_json<json>(command.question.look);
    if (command.question.message) body["message"] = passed_json({0, "", *command.question.message});
  }
  if (!command.proof.empty()) body["proof"] = command.proof;
  return frame(body);
}

std::string proof_frame(const std::string& proof) {
  HostCommand command;
  command.kind = HostCommand::Kind::prove;
  command.proof = proof;
  return encode(command);
}

HostCommand decode_command(const std::string& bytes) {
  return decoded(bytes, [](const json& body) {
    HostCommand command;
    command.kind = parse_kind<HostCommand::Kind>(body, command_names);
    command.instance = discovery::InstanceId(body.value("instance", ""));
    if (body.contains("spec")) command.spec = spec_of(body.at("spec"));
    command.number = body.value("number", std::int64_t{0});
    command.proof = body.value("proof", "");
    if (command.kind == HostCommand::Kind::deliver) command.passed = passed_of(body.at("passed"));
    if (command.kind == HostCommand::Kind::answer) command.answer = answer_of(body);
    if (command.kind == HostCommand::Kind::ask) {
      command.question.look = from_json<discovery::LookRequest>(body.at("question"), between);
      if (body.contains("message")) command.question.message = passed_of(body.at("message")).message;
    }
    if (command.kind == HostCommand::Kind::create && !command.spec) throw config::Error("\"create\" without a spec");
    return command;
  });
}

std::string encode(const HostReport& event) {
  json body = {{"kind", report_names[static_cast<std::size_t>(event.kind)]}};
  switch (event.kind) {
    case HostReport::Kind::hello: {
      json instances = json::array();
      for (const auto& i : event.instances)
        instances.push_back({{"spec", spec_json(i.spec)}, {"status", to_json<json>(i.status)}});
      body.update(to_json<json>(event.order));
      body.update({{"version", event.version},
                   {"answers", event.answers},
                   {"found", {event.order.identity.sha256, event.order.identity.signed_by}},
                   {"instances", instances}});
      break;
    }
    case HostReport::Kind::refused:
      body["reason"] = event.reason;
      break;
    case HostReport::Kind::status:
      body["status"] = to_json<json>(event.status);
      break;
    case HostReport::Kind::pong:
      body.update({{"number", event.number}, {"stalls", json::array()}});
      for (const auto& stall : event.stalls) body["stalls"].push_back(to_json<json>(stall));
      for (const auto& link : event.brokers) body["brokers"].push_back(to_json<json>(link));
      break;
    case HostReport::Kind::metrics:
      body["samples"] = json::array();
      for (const auto& sample : event.samples) body["samples"].push_back(sample_json(sample));
      break;
    case HostReport::Kind::pass:
      body["passed"] = passed_json(event.passed);
      break;
    case HostReport::Kind::answer:
      body.update({{"number", event.number}, {"answer", answer_names[static_cast<std::size_t>(event.answer)]}});
      break;
    case HostReport::Kind::told:
      body.update({{"number", event.number}, {"look", look_json(event.look)}});
      break;
  }
  return frame(body);
}

HostReport decode_report(const std::string& bytes) {
  return decoded(bytes, [](const json& body) {
    HostReport event;
    event.kind = parse_kind<HostReport::Kind>(body, report_names);
    switch (event.kind) {
      case HostReport::Kind::hello:
        event.version = body.at("version");
        if (event.version != protocol::version) break;  // the other members may differ in that version
        event.order = from_json<HostOrder>(body, between);
        event.answers = body.value("answers", false);
        if (body.contains("found")) event.order.identity = {body.at("found").at(0), body.at("found").at(1)};
        for (const auto& i : body.at("instances")) {
          event.instances.push_back({spec_of(i.at("spec")), from_json<InstanceStatus>(i.at("status"), between)});
        }
        break;
      case HostReport::Kind::refused:
        event.reason = body.at("reason");
        break;
      case HostReport::Kind::status:
        event.status = from_json<InstanceStatus>(body.at("status"), between);
        break;
      case HostReport::Kind::pong:
        event.number = body.at("number");
        event.stalls = list_of<Stall>(body.at("stalls"));
        if (body.contains("brokers")) event.brokers = list_of<BrokerLink>(body.at("brokers"));
        break;
      case HostReport::Kind::metrics:
        for (const auto& sample : body.at("samples")) event.samples.push_back(sample_of(sample));
        break;
      case HostReport::Kind::pass:
        event.passed = passed_of(body.at("passed"));
        break;
      case HostReport::Kind::answer:
        event.number = body.at("number");
        event.answer = answer_of(body);
        break;
      case HostReport::Kind::told:
        event.number = body.at("number");
        event.look = look_of(body.at("look"));
        break;
    }
    return event;
  });
}

}  // namespace iotcloud::gateway::protocol
