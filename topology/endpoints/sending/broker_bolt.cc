#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/sending/broker_bolt.h>

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

}  // namespace

void BrokerBolt::prepare(const Config&, const TopologyContext& context, OutputCollector& collector) {
  collector_ = &collector;
  first_task_ = context.task_index == 0;
  if (endpoint_.make_builder) builder_ = endpoint_.make_builder();
  routes_->join();
}

void BrokerBolt::cleanup() {
  routes_->leave(*collector_);
}

void BrokerBolt::execute(const Tuple& tuple) {
  if (tuple.is_tick()) {
    if (first_task_) routes_->on_tick();
    return;
  }
  routes_->send(message_of(tuple), tuple, *collector_);
}

brokers::Message BrokerBolt::message_of(const Tuple& tuple) const {
  brokers::Message message;
  for (std::size_t i = 0; i < endpoint_.roles.size(); ++i) {
    const std::string& field = endpoint_.fields[i];
    switch (endpoint_.roles[i]) {
      case FieldRole::payload: {
        if (builder_) break;
        const Value& value = tuple.at(field);
        if (const auto* bytes = std::get_if<Payload>(&value)) {
          message.payload = *bytes;
        } else if (endpoint_.form == PayloadForm::text) {
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
        if (value.index() != 0) message.properties.set(endpoint_.properties[i], text_of(value));
        break;
      }
      case FieldRole::gateway_id:
      case FieldRole::channel:
      case FieldRole::redelivered:
        break;  // definition.cc refuses such fields of a sending bolt: gateway and channel of a message follow from its
                // driver
    }
  }
  if (message.time_ms == 0) message.time_ms = services_->clock->wall_ms();
  if (builder_) builder_->write(tuple, payload_fields_, message);
  return message;
}

}  // namespace iotcloud::topology
