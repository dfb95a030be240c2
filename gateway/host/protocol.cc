#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/description/words.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/frames.h>

namespace iotcloud::gateway {

namespace {

constexpr discovery::Word<PassAnswer> pass_answers[] = {{PassAnswer::handled, "handled"},
                                                        {PassAnswer::failed, "failed"},
                                                        {PassAnswer::comes, "comes"},
                                                        {PassAnswer::nowhere, "nowhere"}};

}  // namespace

std::string json_value(PassAnswer answer) {
  return discovery::word_of(answer, pass_answers);
}

void parse(const std::string& name, PassAnswer& answer) {
  answer = discovery::value_named(name, pass_answers, "answer to a passed message");
}

}  // namespace iotcloud::gateway

namespace iotcloud::gateway::protocol {

using nlohmann::json;

namespace {

/// The source of an unreadable message, for the error text.
constexpr const char* between = "between gateway and driver host";

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

template <typename... Kinds>
std::string frame_of(const std::variant<Kinds...>& message) {
  const json body = std::visit(
      [](const auto& of_its_kind) {
        auto fields = discovery::to_json<json>(of_its_kind);
        fields["kind"] = of_its_kind.kind;
        return fields;
      },
      message);
  return processes::frame(body.dump(-1, ' ', false, json::error_handler_t::replace));
}

/// Reads `body` into `message` if it is of this kind.
template <typename Kind, typename Message>
bool read_as(const std::string& kind, const json& body, Message& message) {
  if (kind != Kind::kind) return false;
  message = discovery::from_json<Kind>(body, between);
  return true;
}

template <typename... Kinds>
void read(const json& body, std::variant<Kinds...>& message) {
  const auto kind = body.at("kind").get<std::string>();
  if (!(read_as<Kinds>(kind, body, message) || ...)) {
    throw config::Error(fmt::format("\"{}\" is no message between gateway and driver host", kind));
  }
}

/// What a HostHello of every version has.
struct HostHelloOfAnyVersion {
  int version = 0;
  static constexpr const char* what = HostHello::what;
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(version, required)};
};

void read(const json& body, HostReport& report) {
  if (body.at("kind") == HostHello::kind) {
    const auto hello = discovery::from_json<HostHelloOfAnyVersion>(body, between);
    if (hello.version != version) {
      report = HostHello{hello.version, {}, false, {}};
      return;
    }
  }
  read<>(body, report);
}

/// Turns exceptions of the JSON library into config::Error. A host with a broken plugin may send anything: the
/// levels of lists and objects within each other are limited, as in what comes from the registry.
template <typename Message>
Message decoded(const std::string& body) {
  try {
    Message message;
    read(discovery::parse_json(body, std::string("a message ") + between, processes::max_frame), message);
    return message;
  } catch (const json::exception& e) {
    throw config::Error(fmt::format("a message between gateway and driver host cannot be read: {}", e.what()));
  }
}

}  // namespace

json AsSampleList::to(const std::vector<config::Sample>& samples) {
  json list = json::array();
  for (const auto& sample : samples) list.push_back(sample_json(sample));
  return list;
}

void AsSampleList::from(const json& list, std::vector<config::Sample>& samples) {
  samples.clear();
  for (const auto& sample : list) samples.push_back(sample_of(sample));
}

std::string encode(const HostCommand& command) {
  return frame_of(command);
}

std::string encode(const HostReport& report) {
  return frame_of(report);
}

HostCommand decode_command(const std::string& body) {
  return decoded<HostCommand>(body);
}

HostReport decode_report(const std::string& body) {
  return decoded<HostReport>(body);
}

}  // namespace iotcloud::gateway::protocol
