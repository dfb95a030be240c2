#pragma once

#include <string>

#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>

namespace iotcloud::topology {

/// Endpoints on a real RabbitMQ, one for all tests of this process.
class EndpointsOnRabbitMq : public Endpoints {
 protected:
  EndpointsOnRabbitMq() : Endpoints(server().url()) {}

  static tests::PrivateServer& server() {
    static tests::PrivateServer rabbitmq("rabbitmq.py");
    return rabbitmq;
  }
  /// Shows a driver in the registry whose channel `up` is durable.
  void show_driver_with_durable_channel(const std::string& instance) {
    discovery::ChannelRecord channel = channel_record(instance, "up", discovery::Direction::out);
    channel.properties = {{"routingKey", "up"}, {"durable", "true"}};
    put_channel(channel);
    put_driver(driver_record(instance));
  }
  std::unique_ptr<brokers::Publisher> durable_device(const std::string& instance) {
    return broker_->publisher({"", topic(instance, "up"), true}, many());
  }
};

}  // namespace iotcloud::topology
