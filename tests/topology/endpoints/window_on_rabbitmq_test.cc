// A window on a channel whose messages a real RabbitMQ keeps: the server's prefetch does not starve it.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include <iotcloud/tests/topology/endpoints/private_rabbitmq.h>
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

class WindowOnRabbitMq : public EndpointsOnRabbitMq {};

TEST_F(WindowOnRabbitMq, GetsAllThatADurableChannelBringsInItsTime) {
  ComponentRegistry components;
  components.add_bolt("Window", make_windowed_bolt<CountingWindow>({.length = WindowExtent(2s)}));
  run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time]}\n"
      "bolts:\n  count: {class: Window, inputs: {from: in}}\n",
      std::move(components));
  show_driver_with_durable_channel("one");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  constexpr int sent = 1000;
  const auto publisher = durable_device("one");
  for (int i = 0; i < sent; ++i) publisher->publish(message("m", "one"));
  EXPECT_TRUE(eventually([] { return CountingWindow::counted == sent; })) << CountingWindow::counted;
  // The messages are here in less than a window's time, so in two windows at most; the usual prefetch brings 100 to
  // each.
  EXPECT_GE(CountingWindow::largest, sent / 4);
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_prefetch") > 100; }));
}

}  // namespace
}  // namespace iotcloud::topology
