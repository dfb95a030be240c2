#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/console/answers.h>

namespace iotcloud::master {

namespace {

using OrderedJson = nlohmann::ordered_json;

constexpr std::size_t longest_call = 65'536;

std::string base64(const std::string& bytes) {
  std::string text(4 * ((bytes.size() + 2) / 3) + 1, '\0');
  const int size =
      EVP_EncodeBlock(reinterpret_cast<unsigned char*>(text.data()),
                      reinterpret_cast<const unsigned char*>(bytes.data()), static_cast<int>(bytes.size()));
  text.resize(static_cast<std::size_t>(size));
  return text;
}

template <typename Result>
std::string answer_with_outcomes(const Result& result) {
  OrderedJson outcomes = OrderedJson::array();
  for (const auto& outcome : result.outcomes) outcomes.push_back(discovery::to_json<OrderedJson>(outcome));
  return discovery::to_text(
      OrderedJson{{"done", result.all_done()},
                  {"refused", result.refusal != OrderRefusal::none},
                  {"leader", result.leader},
                  {"summary", result.refusal == OrderRefusal::none ? result.summary() : result.text},
                  {"outcomes", std::move(outcomes)}});
}

}  // namespace

std::string answer_of(const OrderResult& result) {
  return answer_with_outcomes(result);
}

std::string answer_of(const TopologyResult& result) {
  return answer_with_outcomes(result);
}

std::string answer_of(const DriverHistory& history) {
  return discovery::to_text(discovery::to_json<OrderedJson>(history));
}

std::string answer_of(const GatewayPlugins& plugins) {
  return discovery::to_text(discovery::to_json<OrderedJson>(plugins));
}

std::string answer_of(discovery::ChannelLook look) {
  for (auto& message : look.messages) message.payload = base64(message.payload);
  return discovery::to_text(discovery::to_json<OrderedJson>(look));
}

nlohmann::json read_arguments(const std::string& call, const std::string& json) {
  auto arguments = discovery::parse_json(json.empty() ? "{}" : json, "the call " + call, longest_call);
  if (!arguments.is_object()) throw config::Error("the arguments of the call " + call + " are a JSON object");
  return arguments;
}

std::string text_of(const nlohmann::json& arguments, const char* key) {
  const auto found = arguments.find(key);
  if (found == arguments.end()) return "";
  if (!found->is_string()) throw config::Error(fmt::format("\"{}\" is a text", key));
  return found->get<std::string>();
}

std::vector<std::string> texts_of(const nlohmann::json& arguments, const char* key) {
  std::vector<std::string> all;
  for (const auto& each : arguments.value(key, nlohmann::json::array())) {
    if (!each.is_string()) throw config::Error(fmt::format("\"{}\" is a list of texts", key));
    all.push_back(each.get<std::string>());
  }
  return all;
}

TopologyRequest read_topology_order(const nlohmann::json& arguments) {
  const auto change = text_of(arguments, "change");
  TopologyRequest request;
  request.topology = discovery::TopologyName(text_of(arguments, "topology"));
  bool known = false;
  for (const auto each :
       {TopologyChange::activate, TopologyChange::deactivate, TopologyChange::rebalance, TopologyChange::kill}) {
    if (to_string(each) != change) continue;
    request.change = each;
    known = true;
  }
  if (!known) throw config::Error("a topology is not changed by \"" + change + "\"");
  const auto parallelism = arguments.value("parallelism", nlohmann::json::object());
  for (const auto& [component, number] : parallelism.items()) {
    if (!number.is_number_integer()) throw config::Error("the parallelism of " + component + " is a whole number");
    request.parallelism[component] = number.get<int>();
  }
  return request;
}

}  // namespace iotcloud::master
