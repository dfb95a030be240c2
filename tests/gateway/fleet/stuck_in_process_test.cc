// What a stuck driver makes a host inside this process leave behind. A program of its own without sanitizers, because
// that is left for good.
#include <atomic>
#include <future>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/gateway/fleet/in_process_launcher.h>
#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/gateway/host/shared_channels.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/message_log.h>
#include <iotcloud/tests/gateway/probe_driver.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

using namespace std::chrono_literals;

/// Reads a shared channel, and never returns from deactivate().
class StuckDriver : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override {
    drivers::ChannelSpec in;
    in.name = "control";
    in.direction = drivers::Direction::in;
    in.shared = true;
    return {in};
  }
  void open(drivers::DriverContext&) override {}
  void deactivate() override {
    deactivating = true;
    static auto& never = *new std::promise<void>;  // not destroyed while the thread waits for it
    never.get_future().wait();
  }
  static inline std::atomic<bool> deactivating{false};
};

TEST(StuckInProcess, NoEventFunctionIsCalledWhenTheLinkIsGoneAlthoughTheHostLivesOn) {
  auto& clock = *new tests::HandClock;  // what is left behind uses it, as the next two
  auto& metrics = *new config::Metrics;
  const auto& stuck = *new drivers::Descriptor(drivers::describe<StuckDriver>("stuck", "1"));
  const std::string url = "embedded://stuck-in-process";
  InProcessLauncher::Options options;
  options.linked_in = {{"stuck.so", &stuck}};
  options.clock = &clock;
  options.metrics = &metrics;
  InProcessLauncher launcher(options);

  StatusLog log;
  std::promise<std::string> ended;
  std::atomic<int> passed{0};
  HostEvents events;
  events.on_status = [&](const InstanceStatus& status) { log.add(status); };
  events.on_ended = [&](const HostEnd& end) { ended.set_value(end.reason); };
  events.on_pass = [&](const PassedMessage&) { ++passed; };
  HostOrder order;
  order.plugin = "stuck.so";
  order.gateway = "gw"_gateway;
  auto link = launcher.launch(order, events);
  InstanceSpec spec;
  spec.order.instance = "a"_instance;
  spec.order.plugin = "stuck.so";
  spec.brokers = {{"local", "embedded", {}, {url}, {url}}};
  link->create(spec);
  ASSERT_TRUE(log.wait_for("a", discovery::DriverState::active));
  link->deactivate("a"_instance);
  ASSERT_TRUE(tests::eventually([] { return StuckDriver::deactivating.load(); }));
  link->shutdown(1ms);
  EXPECT_THAT(ended.get_future().get(), testing::HasSubstr("a driver is stuck in a callback"));
  link.reset();

  // The host's subscription lives on: a message for another instance is offered to the gateway, and given up later.
  const tests::CapturedLog said;
  MessageSender sender(url, {"stuck", "gw.stuck.control", false});
  sender.send("x", "b");
  ASSERT_TRUE(tests::eventually([&] {
    clock.advance(SharedChannels::longest_wait);
    return passed > 0 || said.contains("the last for \"b\"");
  })) << said.text();
  EXPECT_EQ(passed, 0);
}

/// Publishes something that nobody reads, and says when it is closed.
class ClosedDriver : public ProbeDriver {
 public:
  void close() override { closed = true; }
  static inline std::atomic<bool> closed{false};
};

TEST(StuckInProcess, AStopThatIsTooShortToSendWhatWasPublishedBlamesNoDriver) {
  auto& metrics = *new config::Metrics;  // what is left behind uses it
  DriverHost::Options options;
  options.gateway = "gw"_gateway;
  options.metrics = &metrics;
  options.drain_limit = std::chrono::hours(1);  // nobody reads what this driver sends
  StatusLog log;
  const auto& probe = *new drivers::Descriptor(drivers::describe<ClosedDriver>("probe", "1"));
  DriverHost host(options, Plugin::wrap(probe, "linked in"), [&](const InstanceStatus& status) { log.add(status); });
  InstanceSpec spec;
  spec.order.instance = "a"_instance;
  spec.order.plugin = "probe.so";
  const std::string url = "embedded://too-short-a-stop";
  spec.brokers = {{"local", "embedded", {}, {url}, {url}}};
  host.create(spec);
  ASSERT_TRUE(log.wait_for("a", discovery::DriverState::active));
  host.remove("a"_instance, Removal::undeployed);
  ASSERT_TRUE(tests::eventually([] { return ClosedDriver::closed.load(); }));
  EXPECT_FALSE(host.stop(1s));
  EXPECT_EQ(
      host.left_behind(),
      "1 instance(s) did not end within 1000 ms; 1 of them have closed, and were sending what they had published");
}

}  // namespace
}  // namespace iotcloud::gateway
