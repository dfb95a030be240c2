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
    discovery::ChannelRecord channel;
    channel.name = "up";
    channel.transport = "rabbitmq";
    channel.direction = discovery::Direction::out;
    channel.properties = {{"routingKey", "up"}, {"durable", "true"}};
    channel.broker_url = broker_url_;
    channel.gateway = "g"_gateway;
    channel.driver = "d"_driver;
    channel.instance = discovery::InstanceId(instance);
    discovery::put(*registry_, paths_.channel("d"_driver, channel.instance, "up"), discovery::encode(channel));
    discovery::DriverRecord driver;
    driver.name = "d"_driver;
    driver.instance = channel.instance;
    driver.gateway = "g"_gateway;
    driver.state = discovery::DriverState::active;
    discovery::put(*registry_, paths_.instance("d"_driver, driver.instance), discovery::encode(driver));
  }
  std::unique_ptr<brokers::Publisher> durable_device(const std::string& instance) {
    return broker_->publisher({"", topic(instance, "up"), true}, many());
  }
};

}  // namespace iotcloud::topology
