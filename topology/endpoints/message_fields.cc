#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/json_builder.h>
#include <iotcloud/topology/endpoints/message_fields.h>

namespace iotcloud::topology {

namespace {

std::string text_of(const Value& value) {
  return std::visit(
      [](const auto& v) -> std::string {
        using Kind = std::decay_t<decltype(v)>;
        if constexpr (std::is_same_v<Kind, std::monostate>) {
          return "";
        } else if constexpr (std::is_same_v<Kind, std::string>) {
          return v;
        } else if constexpr (std::is_same_v<Kind, Payload>) {
          return std::string(v.text());
        } else {
          return fmt::format("{}", v);
        }
      },
      value);
}

Values built_values_of(const brokers::Message& message, const Fields& fields, MessageBuilder& builder) {
  Values built = builder.read(message, fields);
  if (built.size() == fields.size()) return built;
  throw std::length_error(fmt::format("it made {} values for the fields {}", built.size(), fields.list()));
}

}  // namespace

Values values_of(const brokers::Message& message, const EndpointDefinition& endpoint, const Fields& built_fields,
                 MessageBuilder* builder, bool redelivered) {
  const Values built = builder != nullptr ? built_values_of(message, built_fields, *builder) : Values();
  std::size_t next_built = 0;
  Values values;
  for (std::size_t i = 0; i < endpoint.roles.size(); ++i) {
    switch (endpoint.roles[i]) {
      case FieldRole::payload:
        if (builder != nullptr) {
          values.add(built[next_built++]);
        } else if (endpoint.form == PayloadForm::text) {
          values.add(std::string(message.payload.text()));
        } else {
          values.add(message.payload);
        }
        break;
      case FieldRole::driver_id:
        values.add(message.driver_id);
        break;
      case FieldRole::time:
        values.add(message.time_ms);
        break;
      case FieldRole::gateway_id:
        values.add(message.gateway_id);
        break;
      case FieldRole::channel:
        values.add(endpoint.channel);
        break;
      case FieldRole::redelivered:
        values.add(redelivered);
        break;
      case FieldRole::property: {
        const std::string* property = message.properties.find(endpoint.properties[i]);
        values.add(property == nullptr ? Value() : Value(*property));
        break;
      }
    }
  }
  return values;
}

brokers::Message message_of(const Tuple& tuple, const EndpointDefinition& endpoint, const Fields& built,
                            MessageBuilder* builder, const config::Clock& clock) {
  brokers::Message message;
  for (std::size_t i = 0; i < endpoint.roles.size(); ++i) {
    const std::string& field = endpoint.fields[i];
    switch (endpoint.roles[i]) {
      case FieldRole::payload: {
        if (builder != nullptr) break;
        const Value& value = tuple.at(field);
        if (const auto* bytes = std::get_if<Payload>(&value)) {
          message.payload = *bytes;
        } else if (endpoint.form == PayloadForm::text) {
          message.payload = Payload::take(text_of(value));
        } else {
          message.payload = Payload::copy(tuple.get<std::string>(field));
        }
        break;
      }
      case FieldRole::driver_id:
        message.driver_id = tuple.get<std::string>(field);
        break;
      case FieldRole::time:
        message.time_ms = tuple.get<std::int64_t>(field);
        break;
      case FieldRole::property: {
        const Value& value = tuple.at(field);
        if (value.index() != 0) message.properties.set(endpoint.properties[i], text_of(value));
        break;
      }
      case FieldRole::gateway_id:
      case FieldRole::channel:
      case FieldRole::redelivered:
        break;  // definition.cc refuses such fields of a sending bolt: gateway and channel of a message follow from its
                // driver
    }
  }
  if (message.time_ms == 0) message.time_ms = clock.wall_ms();
  if (builder != nullptr) builder->write(tuple, built, message);
  return message;
}

EndpointDefinition with_own_builder(EndpointDefinition endpoint) {
  if (endpoint.builder == "json") endpoint.make_builder = [] { return std::make_unique<JsonBuilder>(); };
  return endpoint;
}

}  // namespace iotcloud::topology
