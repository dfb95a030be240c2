#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/broker_bolt.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};
/// A burst is over when nothing of its kind came for so long.
constexpr std::chrono::seconds burst_end{10};

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
  component_ = context.component;
  unknown_ = &services_->metrics->counter("iotcloud_bolt_unknown_driver_total", "Tuples for a driver that is not there",
                                          {{"topology", context.topology}, {"component", context.component}});
  routes_->join();
}

void BrokerBolt::cleanup() {
  routes_->leave(*collector_);
}

void BrokerBolt::execute(const Tuple& tuple) {
  if (tuple.is_tick()) {
    routes_->reset_timeouts();
    collector_->ack(tuple);
    return;
  }
  brokers::Message message = message_of(tuple);
  const auto route = routes_->find(message.driver_id);
  if (!route.sender) {
    no_route(tuple, message.driver_id);
    return;
  }
  message.gateway_id = route.gateway;
  route.sender->send(std::move(message), tuple, *collector_);
}

brokers::Message BrokerBolt::message_of(const Tuple& tuple) const {
  brokers::Message message;
  for (std::size_t i = 0; i < endpoint_.roles.size(); ++i) {
    const std::string& field = endpoint_.fields[i];
    switch (endpoint_.roles[i]) {
      case FieldRole::payload: {
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
    }
  }
  if (message.time_ms == 0) message.time_ms = services_->clock->wall_ms();
  return message;
}

void BrokerBolt::no_route(const Tuple& tuple, const std::string& driver_id) {
  unknown_->add();
  const auto now = services_->clock->now();
  if (!last_unknown_ || now - *last_unknown_ > burst_end) {
    logger.warn("{}: there is no driver {} with the id \"{}\" and a channel \"{}\"; further ones are only counted",
                component_, endpoint_.driver, driver_id, endpoint_.channel);
  }
  last_unknown_ = now;
  if (endpoint_.sending.unknown_driver == UnknownDriver::fail) {
    collector_->fail(tuple);
  } else {
    collector_->ack(tuple);
  }
}

}  // namespace iotcloud::topology
