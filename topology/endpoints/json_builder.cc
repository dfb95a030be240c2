#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

#include <nlohmann/json.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/topology/endpoints/json_builder.h>

namespace iotcloud::topology {

namespace {

using Json = nlohmann::json;

constexpr std::size_t longest_json = std::size_t{16} << 20;

Value value_of(const std::string& key, const Json& json) {
  switch (json.type()) {
    case Json::value_t::null:
      return {};
    case Json::value_t::boolean:
      return json.get<bool>();
    case Json::value_t::number_unsigned:
      if (json.get<std::uint64_t>() > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) {
        throw std::runtime_error("\"" + key + "\" is " + json.dump() + ", which does not fit into 64 bits with a sign");
      }
      return json.get<std::int64_t>();
    case Json::value_t::number_integer:
      return json.get<std::int64_t>();
    case Json::value_t::number_float:
      return json.get<double>();
    case Json::value_t::string:
      return json.get<std::string>();
    default:
      return json.dump();
  }
}

nlohmann::ordered_json json_of(const std::string& key, const Value& value) {
  return std::visit(
      [&](const auto& v) -> nlohmann::ordered_json {
        using Kind = std::decay_t<decltype(v)>;
        if constexpr (std::is_same_v<Kind, std::monostate>) {
          return nullptr;
        } else if constexpr (std::is_same_v<Kind, Payload>) {
          return std::string(v.text());
        } else if constexpr (std::is_same_v<Kind, double>) {
          if (!std::isfinite(v)) throw std::runtime_error("\"" + key + "\" is no number that JSON has");
          return v;
        } else {
          return v;
        }
      },
      value);
}

}  // namespace

Values JsonBuilder::read(const brokers::Message& message, const Fields& fields) {
  const Json json = discovery::parse_json(std::string(message.payload.text()), "the payload", longest_json);
  if (!json.is_object())
    throw std::runtime_error(std::string("the payload is no JSON object but a ") + json.type_name());
  Values values;
  for (const std::string& field : fields) {
    const auto found = json.find(field);
    values.add(found == json.end() ? Value() : value_of(field, *found));
  }
  return values;
}

void JsonBuilder::write(const Tuple& tuple, const Fields& fields, brokers::Message& message) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  for (const std::string& field : fields) json[field] = json_of(field, tuple.at(field));
  message.payload = Payload::take(json.dump());
}

}  // namespace iotcloud::topology
