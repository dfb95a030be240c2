// A window on a channel whose messages a real RabbitMQ keeps: the server's prefetch does not starve it.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;

/// Counts the tuples of its windows.
class CountingWindow final : public WindowedBolt {
 public:
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector&) override {}
  void execute(const TupleWindow& window) override {
    const int size = static_cast<int>(window.tuples().size());
    largest = std::max(largest.load(), size);
    counted += size;
  }

  static inline std::atomic<int> largest{0};
  static inline std::atomic<int> counted{0};  ///< in all windows, which do not overlap
};

class WindowOnRabbitMq : public Endpoints {
 protected:
  WindowOnRabbitMq() : Endpoints(server().url()) {}

  static tests::PrivateServer& server() {
    static tests::PrivateServer rabbitmq("rabbitmq.py");
    return rabbitmq;
  }
  void show_driver_with_durable_channel() {
    discovery::ChannelRecord channel;
    channel.name = "up";
    channel.transport = "rabbitmq";
    channel.direction = discovery::Direction::out;
    channel.properties = {{"routingKey", "up"}, {"durable", "true"}};
    channel.broker_url = broker_url_;
    channel.gateway = "g"_gateway;
    channel.driver = "d"_driver;
    channel.instance = "one"_instance;
    discovery::put(*registry_, paths_.channel("d"_driver, "one"_instance, "up"), discovery::encode(channel));
    discovery::DriverRecord driver;
    driver.name = "d"_driver;
    driver.instance = "one"_instance;
    driver.gateway = "g"_gateway;
    driver.state = discovery::DriverState::active;
    discovery::put(*registry_, paths_.instance("d"_driver, "one"_instance), discovery::encode(driver));
  }
};

TEST_F(WindowOnRabbitMq, GetsAllThatADurableChannelBringsInItsTime) {
  ComponentRegistry components;
  components.add_bolt("Window", make_windowed_bolt<CountingWindow>({.length = WindowExtent(2s)}));
  run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time]}\n"
      "bolts:\n  count: {class: Window, inputs: {from: in}}\n",
      std::move(components));
  show_driver_with_durable_channel();
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  constexpr int sent = 1000;
  const auto publisher = broker_->publisher({"", topic("one", "up"), true}, many());
  for (int i = 0; i < sent; ++i) publisher->publish(message("m", "one"));
  EXPECT_TRUE(eventually([] { return CountingWindow::counted == sent; })) << CountingWindow::counted;
  // The messages are here in less than a window's time, so in two windows at most; the usual prefetch brings 100 to
  // each.
  EXPECT_GE(CountingWindow::largest, sent / 4);
  EXPECT_GT(metric("iotcloud_spout_prefetch"), 100);
}

}  // namespace
}  // namespace iotcloud::topology
