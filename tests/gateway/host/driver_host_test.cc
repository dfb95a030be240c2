#include <algorithm>
#include <atomic>
#include <filesystem>
#include <future>
#include <map>
#include <stdexcept>
#include <utility>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/gateway/host/round_trips.h>
#include <iotcloud/gateway/host/shared_channels.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/message_log.h>
#include <iotcloud/tests/gateway/probe_driver.h>
#include <iotcloud/tests/gateway/status_log.h>
#include <iotcloud/tests/lock_calls.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

/// Blocks in activate() until it is let go.
class BlockingDriver : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }
  void open(drivers::DriverContext& context) override { blocks_ = context.property("block", "no") == "yes"; }
  void activate() override {
    if (blocks_) go_on.get_future().wait();
  }
  static inline std::promise<void> go_on;

 private:
  bool blocks_ = false;
};

/// Declares its properties, and tells in its metadata what it got.
struct DeclaringDriver : drivers::Driver {
  static constexpr std::array declared_properties{
      drivers::PropertySpec{.name = "rate", .type = drivers::PropertyType::integer, .min = 1, .default_value = "7"}};
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }
  void open(drivers::DriverContext& context) override { context.update_metadata({{"got", context.property("rate")}}); }
};

class DriverHostTest : public ::testing::Test {
 protected:
  void start_host(const drivers::Descriptor& descriptor, const config::Clock* clock = nullptr) {
    DriverHost::Options options;
    options.clock = clock;
    options.gateway = "gw"_gateway;
    options.metrics = &metrics_;
    options.drain_limit = 50ms;  // nobody reads most of what these drivers send
    options.state_folder = state_folder_;
    host_.emplace(options, Plugin::wrap(descriptor, "linked in"), [this](const auto& status) { log_.add(status); });
  }

  InstanceSpec spec(const std::string& id, std::map<std::string, std::string> properties = {}) {
    InstanceSpec spec;
    spec.order.instance = discovery::InstanceId(id);
    spec.order.plugin = "probe.so";
    spec.order.properties = std::move(properties);
    spec.brokers = {{"local", "embedded", {}, {url_}, {url_}}};
    return spec;
  }

  std::uint64_t count(const std::string& metric) {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == metric) sum += sample.value;
    }
    return static_cast<std::uint64_t>(sum);
  }

  std::string state_folder_;
  static inline std::atomic<int> next_broker_{0};
  const std::string url_ = "embedded://driver-host-test-" + std::to_string(next_broker_++);
  const drivers::Descriptor probe_ = drivers::describe<ProbeDriver>("probe", "1");
  const drivers::Descriptor blocking_ = drivers::describe<BlockingDriver>("blocking", "1");
  tests::HandClock clock_;  ///< of hosts that are started with it
  config::Metrics metrics_;
  StatusLog log_;
  std::optional<DriverHost> host_;
};

TEST_F(DriverHostTest, AnInstanceLivesThroughItsStatesAndSaysSo) {
  start_host(probe_);
  host_->create(spec("a"));
  const auto active = log_.wait_for("a", DriverState::active);
  ASSERT_TRUE(active);
  EXPECT_EQ(active->driver, "probe");
  ASSERT_EQ(active->channels.size(), 2u);
  EXPECT_EQ(active->channels[0].properties.at("routingKey"), "readings");
  host_->deactivate("a"_instance);
  host_->activate("a"_instance);
  host_->remove("a"_instance, Removal::undeployed);
  const auto gone = log_.wait_for("a", DriverState::undeployed);
  ASSERT_TRUE(gone);
  EXPECT_TRUE(gone->channels.empty());
  EXPECT_TRUE(host_->list().empty());
  EXPECT_THAT(log_.states("a"),
              ElementsAre(DriverState::starting, DriverState::active, DriverState::stopping, DriverState::inactive,
                          DriverState::starting, DriverState::active, DriverState::stopping, DriverState::undeployed));
}

TEST_F(DriverHostTest, ADriverGetsTheDefaultsThatItDeclaresAndNothingThatItDoesNot) {
  static const auto declaring = drivers::describe<DeclaringDriver>("declaring", "1");
  start_host(declaring);
  host_->create(spec("good", {{"channel.x.capacity", "5"}, {"hang_limit", "5s"}}));
  host_->create(spec("bad", {{"rat", "5"}, {"rate", "0"}}));
  const auto bad = log_.wait_for("bad", DriverState::failed);
  ASSERT_TRUE(bad);
  EXPECT_EQ(bad->reason,
            "property \"rat\": unknown property; did you mean \"rate\"?; property \"rate\": \"0\"; it takes a whole "
            "number from 1 on");
  // It has no channel x, which the host says, not the declaration.
  const auto good = log_.wait_for("good", DriverState::failed);
  ASSERT_TRUE(good);
  EXPECT_THAT(good->reason, HasSubstr("has no channel \"x\""));
  host_->create(spec("plain"));
  ASSERT_TRUE(log_.wait_for("plain", DriverState::active));
  EXPECT_TRUE(tests::eventually([&] {
    for (const auto& instance : host_->list()) {
      if (instance.status.instance == "plain"_instance)
        return instance.status.metadata.contains("got") && instance.status.metadata.at("got") == "7";
    }
    return false;
  }));
}

TEST_F(DriverHostTest, AnInstanceStopsWhenItsLeaseRunsOutAndStartsAgainWithTheNext) {
  start_host(probe_, &clock_);
  host_->renew(clock_.now());
  host_->create(spec("a", {{"on_partition", "stop"}, {"lease", "30s"}}));
  host_->create(spec("b"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  ASSERT_TRUE(log_.wait_for("b", DriverState::active));
  clock_.advance(29s);
  EXPECT_EQ(host_->enforce_leases(), 1s);
  clock_.advance(1s);
  EXPECT_EQ(host_->enforce_leases(), std::nullopt);
  const auto stopped = log_.wait_for("a", DriverState::inactive);
  ASSERT_TRUE(stopped);
  EXPECT_THAT(stopped->reason, HasSubstr("stopped: no lease since 2020-01-01T"));
  host_->renew(clock_.now() - 31s);  // what it knew already
  EXPECT_EQ(host_->list().at(0).status.state, DriverState::inactive);
  host_->renew(clock_.now());
  EXPECT_TRUE(tests::eventually([&] { return host_->list().at(0).status.state == DriverState::active; }));
  EXPECT_EQ(host_->list().at(1).status.state, DriverState::active);
  EXPECT_THAT(log_.states("b"), ElementsAre(DriverState::starting, DriverState::active)) << "it has no lease";
  EXPECT_EQ(count("iotcloud_driver_lease_stops_total"), 1U);
}

TEST_F(DriverHostTest, AnInstanceWithALeaseWaitsForItsFirst) {
  start_host(probe_, &clock_);
  host_->create(spec("a", {{"on_partition", "stop"}, {"lease", "30s"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::inactive));
  host_->renew(clock_.now());
  EXPECT_TRUE(log_.wait_for("a", DriverState::active));
}

TEST_F(DriverHostTest, AnOrderedStopUnderWayIsNotTakenForTheEndByTheLease) {
  start_host(probe_, &clock_);
  host_->renew(clock_.now());
  host_->create(spec("a", {{"on_partition", "stop"}, {"lease", "30s"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  clock_.advance(30s);
  host_->deactivate("a"_instance);
  host_->enforce_leases();
  host_->renew(clock_.now());
  // It starts again when it has closed, and not when it is inactive, and as its last order says.
  const std::vector wanted{DriverState::starting, DriverState::active,   DriverState::stopping, DriverState::inactive,
                           DriverState::inactive, DriverState::starting, DriverState::inactive};
  EXPECT_TRUE(tests::eventually([&] { return log_.states("a") == wanted; }));
}

TEST_F(DriverHostTest, AnInstanceThatIsRemovedWhileItHasNoLeaseDoesNotComeBack) {
  start_host(probe_, &clock_);
  host_->create(spec("a", {{"on_partition", "stop"}, {"lease", "30s"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::inactive));
  host_->remove("a"_instance, Removal::undeployed);
  host_->renew(clock_.now());
  ASSERT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_TRUE(host_->list().empty());
  EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::inactive, DriverState::stopping, DriverState::undeployed));
}

TEST_F(DriverHostTest, AnInstanceThatIsOrderedInactiveIsOpenedOnly) {
  start_host(probe_);
  auto inactive = spec("a");
  inactive.order.active = false;
  host_->create(inactive);
  host_->remove("a"_instance, Removal::undeployed);
  ASSERT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::starting, DriverState::inactive, DriverState::stopping,
                                            DriverState::undeployed));
}

TEST_F(DriverHostTest, TheQueueOfAnUndeployedInstancesOwnChannelGoesAndThatOfAReplacedOneStays) {
  start_host(probe_);
  const auto server = brokers::embedded::Server::named(url_.substr(11));
  for (const char* id : {"undeployed", "replaced"}) {
    host_->create(spec(id));
    ASSERT_TRUE(log_.wait_for(id, DriverState::active));
    ASSERT_TRUE(server.has_queue("gw.probe." + std::string(id) + ".control", ""));
  }
  host_->remove("replaced"_instance, Removal::replaced);
  host_->remove("undeployed"_instance, Removal::undeployed);
  ASSERT_TRUE(log_.wait_for("undeployed", DriverState::undeployed));
  EXPECT_TRUE(tests::eventually([&] { return !server.has_queue("gw.probe.undeployed.control", ""); }));
  ASSERT_TRUE(host_->stop(120s));
  EXPECT_TRUE(server.has_queue("gw.probe.replaced.control", ""));
}

TEST_F(DriverHostTest, MessagesLeaveUnderTheWireNameWithTheirOrigin) {
  start_host(probe_);
  host_->create(spec("a"));
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  const auto message = reader.next();
  ASSERT_TRUE(message);
  EXPECT_EQ(message->payload.text(), "up");
  EXPECT_EQ(message->driver_id, "a");
  EXPECT_EQ(message->gateway_id, "gw");
  EXPECT_GT(message->time_ms, 0);
}

TEST_F(DriverHostTest, ABrokerThatIsAwayIsShownInTheMetrics) {
  start_host(probe_);
  host_->create(spec("a"));
  ASSERT_TRUE(MessageLog(url_, {"probe", "gw.probe.a.readings", false}).next());
  EXPECT_EQ(count("iotcloud_driver_broker_away"), 0U);
  auto server = brokers::embedded::Server::named(url_.substr(url_.find("//") + 2));
  server.stop();
  EXPECT_TRUE(tests::eventually([&] { return count("iotcloud_driver_broker_away") == 1; }));
  server.start();
  EXPECT_TRUE(tests::eventually([&] { return count("iotcloud_driver_broker_away") == 0; }));
}

TEST_F(DriverHostTest, WhatWaitsInAChannelIsShownWithTheAgeOfTheOldest) {
  start_host(probe_);
  const auto before = std::chrono::steady_clock::now();
  host_->create(spec("a"));
  host_->create(spec("b"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  ASSERT_TRUE(log_.wait_for("b", DriverState::active));
  EXPECT_EQ(count("iotcloud_driver_channel_waiting"), 2U) << "nobody reads what each sent when it was activated";
  double oldest = 0;
  EXPECT_TRUE(tests::eventually([&] {
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == "iotcloud_driver_channel_oldest_seconds" && sample.labels.at("channel") == "readings")
        oldest = sample.value;
    }
    return oldest > 0;
  }));
  EXPECT_LE(oldest, std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count());
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false}),
      other(url_, {"probe", "gw.probe.b.readings", false});
  EXPECT_TRUE(tests::eventually([&] { return count("iotcloud_driver_channel_waiting") == 0; }));
}

TEST_F(DriverHostTest, TheBrokersOfAHostSaySinceWhenTheyAreAway) {
  start_host(probe_, &clock_);
  host_->create(spec("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  const auto connected = host_->brokers();
  ASSERT_EQ(connected.size(), 1U);
  EXPECT_EQ(connected[0].broker, "local");
  EXPECT_EQ(connected[0].state, "connected");
  clock_.advance(5s);
  EXPECT_EQ(host_->brokers(), connected) << "it has been connected since then";
  brokers::embedded::Server::named(url_.substr(url_.find("//") + 2)).stop();
  ASSERT_TRUE(tests::eventually([&] { return host_->brokers().at(0).state == "away"; }));
  EXPECT_EQ(host_->brokers()[0].since_ms, connected[0].since_ms + 5000);
}

TEST_F(DriverHostTest, AMessageOnAnExclusiveChannelReachesItsInstance) {
  start_host(probe_);
  host_->create(spec("a"));
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  ASSERT_TRUE(reader.next());  // "up"
  MessageSender sender(url_, {"probe", "gw.probe.a.control", false});
  sender.send("hello", "a");
  const auto echo = reader.next();
  ASSERT_TRUE(echo);
  EXPECT_EQ(echo->payload.text(), "hello");
}

TEST_F(DriverHostTest, TheAnswerToAMessageIsTimed) {
  start_host(probe_);
  host_->create(spec("a"));
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  const auto up = reader.next();
  ASSERT_TRUE(up);
  MessageSender sender(url_, {"probe", "gw.probe.a.control", false});
  sender.send("an order", "a", up->time_ms - 1);
  sender.send("the answer", "a", up->time_ms);
  ASSERT_TRUE(reader.next() && reader.next());  // the probe sends on what it gets
  const auto carried = carried_messages(metrics_.collect());
  ASSERT_EQ(carried.size(), 1U);
  EXPECT_EQ(carried[0].received, 2U);
  ASSERT_EQ(carried[0].round_trips.size(), 1U);
  EXPECT_EQ(carried[0].round_trips.begin()->second, 1U) << "of the answer alone";
}

TEST_F(DriverHostTest, AMessageOnASharedChannelReachesTheInstanceThatItNames) {
  start_host(probe_);
  host_->create(spec("a", {{"shared", "true"}}));
  host_->create(spec("b", {{"shared", "true"}}));
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  ASSERT_TRUE(reader.next());
  ASSERT_TRUE(reader.next());
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  sender.send("to b", "b");
  sender.send("to a", "a");
  const auto first = reader.next();
  const auto second = reader.next();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->payload.text(), "to b");
  EXPECT_EQ(first->driver_id, "b");
  EXPECT_EQ(second->payload.text(), "to a");
  EXPECT_EQ(second->driver_id, "a");
}

/// The next message that is no "up"; empty if none came in time.
std::string next_echo(MessageLog& reader) {
  while (const auto message = reader.next()) {
    if (message->payload.text() != "up") return std::string(message->payload.text());
  }
  return "";
}

TEST_F(DriverHostTest, WhatWaitsBehindACommandThatADriverThrowsOnIsHandedToItsNextLife) {
  start_host(probe_);
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  constexpr int commands = 50;
  MessageSender sender(url_, {"probe", "gw.probe.a.control", false});
  for (int i = 0; i < commands; ++i) sender.send(std::to_string(i), "a");
  host_->create(spec("a", {{"throw_in", "message"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::failed));
  host_->create(spec("a"));
  for (int i = 1; i < commands; ++i) ASSERT_EQ(next_echo(reader), std::to_string(i));
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 1u);
  EXPECT_TRUE(tests::eventually([&] { return count("iotcloud_driver_received_total") == commands; }));
}

TEST_F(DriverHostTest, ACommandOnASharedChannelWaitsForItsInstance) {
  start_host(probe_);
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  host_->create(spec("a", {{"shared", "true"}}));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  sender.send("first to b", "b");
  sender.send("second to b", "b");
  sender.send("to a", "a");
  ASSERT_EQ(next_echo(reader), "to a");
  host_->create(spec("b", {{"shared", "true"}}));
  ASSERT_EQ(next_echo(reader), "first to b");
  ASSERT_EQ(next_echo(reader), "second to b");
}

TEST_F(DriverHostTest, WhatWaitsOnASharedChannelForAnInstanceThatFailedIsHandedToItsNextLife) {
  start_host(probe_);
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  host_->create(spec("b", {{"shared", "true"}}));
  host_->create(spec("a", {{"shared", "true"}, {"throw_in", "message"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  constexpr int commands = 50;
  for (int i = 0; i < commands; ++i) sender.send(std::to_string(i), "a");
  ASSERT_TRUE(log_.wait_for("a", DriverState::failed));
  host_->create(spec("a", {{"shared", "true"}}));
  for (int i = 1; i < commands; ++i) ASSERT_EQ(next_echo(reader), std::to_string(i));
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 1u);
}

TEST_F(DriverHostTest, ACommandForAnInstanceThatDoesNotComeIsGivenUpAndCountedThenItsNextOnesAtOnce) {
  const tests::CapturedLog log;
  start_host(probe_, &clock_);
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  host_->create(spec("a", {{"shared", "true"}}));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  sender.send("lost", "c");
  sender.send("to a", "a");
  ASSERT_EQ(next_echo(reader), "to a");
  clock_.advance(SharedChannels::grace - 1ms);
  sender.send("still to a", "a");
  ASSERT_EQ(next_echo(reader), "still to a");
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 0u);
  clock_.advance(1ms);
  ASSERT_TRUE(tests::eventually([&] { return count("iotcloud_driver_lost_total") == 1; }));
  EXPECT_TRUE(tests::eventually([&] { return log.contains("the last for \"c\""); })) << log.text();
  sender.send("lost at once", "c");
  ASSERT_TRUE(tests::eventually([&] { return count("iotcloud_driver_lost_total") == 2; }));
  host_->create(spec("c", {{"shared", "true"}}));
  ASSERT_TRUE(log_.wait_for("c", DriverState::active));
  sender.send("to c", "c");
  ASSERT_EQ(next_echo(reader), "to c");
}

TEST_F(DriverHostTest, ACommandForAnInstanceThatFailedWaitsForItsRestart) {
  start_host(probe_, &clock_);
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  host_->create(spec("a", {{"shared", "true"}}));
  host_->create(spec("b", {{"shared", "true"}, {"throw_in", "message"}}));
  ASSERT_TRUE(log_.wait_for("b", DriverState::active));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  sender.send("throw", "b");
  ASSERT_TRUE(log_.wait_for("b", DriverState::failed));
  sender.send("wait", "b");
  sender.send("to a", "a");
  ASSERT_EQ(next_echo(reader), "to a");
  clock_.advance(SharedChannels::longest_wait - 1ms);
  sender.send("look", "unknown");  // the first message for an instance makes the host look at all that wait
  sender.send("to a again", "a");
  ASSERT_EQ(next_echo(reader), "to a again");
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 1u);
  host_->create(spec("b", {{"shared", "true"}}));
  ASSERT_EQ(next_echo(reader), "wait");
}

/// Two hosts of one driver on one gateway, as during an update, or with two files of one driver's plugins. The test
/// passes their messages on as the gateway does.
class TwoHosts : public DriverHostTest {
 protected:
  TwoHosts() {
    open(first_, second_);
    open(second_, first_);
  }
  ~TwoHosts() override {
    first_->stop(tests::patience);
    second_->stop(tests::patience);
  }
  InstanceSpec shared(const std::string& id) { return spec(id, {{"shared", "true"}}); }
  /// Reads until each of these instances has echoed the commands 0 to `count` - 1. \return what came out of order, or
  /// did not come. A command that is echoed again counts once.
  std::string misses(MessageLog& reader, const std::vector<std::string>& instances, int count) {
    std::map<std::string, int> next;
    for (const auto& id : instances) next[id] = 0;
    std::string wrong;
    const auto all = [&] {
      return std::all_of(next.begin(), next.end(), [&](const auto& entry) { return entry.second == count; });
    };
    while (!all()) {
      const auto message = reader.next();
      if (!message) return wrong + " and then nothing came";
      if (message->payload.text() == "up") continue;
      const int number = std::stoi(std::string(message->payload.text()));
      int& expected = next[message->driver_id];
      if (number > expected) wrong += " " + message->driver_id + ":" + std::to_string(number);
      expected = std::max(expected, number + 1);
    }
    return wrong;
  }
  void send_to(MessageSender& sender, const std::vector<std::string>& instances, int from, int count) {
    for (int i = from; i < from + count; ++i) {
      for (const auto& id : instances) sender.send(std::to_string(i), id);
    }
  }

  enum class Gateway { passes, away, forgets };
  std::atomic<Gateway> gateway_{Gateway::passes};
  std::atomic<int> forgotten_{0};
  std::optional<DriverHost> first_, second_;

 private:
  void open(std::optional<DriverHost>& host, std::optional<DriverHost>& other) {
    DriverHost::Options options;
    options.gateway = "gw"_gateway;
    options.clock = &clock_;  // it stands still, so nothing is given up
    options.metrics = &metrics_;
    options.drain_limit = 50ms;
    options.passing.pass = [this, &other](const PassedMessage& message) -> std::optional<NotPassed> {
      if (gateway_ == Gateway::forgets) ++forgotten_;
      if (gateway_ == Gateway::passes) other->deliver(message);
      if (gateway_ == Gateway::away) return NotPassed::gateway_away;
      return std::nullopt;
    };
    options.passing.answer = [&other](std::int64_t number, PassAnswer answer) { other->answered(number, answer); };
    host.emplace(options, Plugin::wrap(probe_, "linked in"), [this](const auto& status) { log_.add(status); });
  }
};

TEST_F(TwoHosts, OfOneDriverBothGetTheirCommandsOnASharedChannel) {
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  first_->create(shared("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  second_->create(shared("b"));
  ASSERT_TRUE(log_.wait_for("b", DriverState::active));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  send_to(sender, {"a", "b"}, 0, 50);
  EXPECT_EQ(misses(reader, {"a", "b"}, 50), "");
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 0u);
}

TEST_F(TwoHosts, LoseNoCommandWhileInstancesMoveFromOneToTheOther) {
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  const std::vector<std::string> instances{"a", "b", "c", "d"};
  for (const auto& id : instances) {
    first_->create(shared(id));
    ASSERT_TRUE(log_.wait_for(id, DriverState::active));
  }
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  int sent = 0;
  for (const auto& id : instances) {
    send_to(sender, instances, sent, 20);
    first_->remove(discovery::InstanceId(id), Removal::undeployed);
    ASSERT_TRUE(log_.wait_for(id, DriverState::undeployed));
    send_to(sender, instances, sent + 20, 20);
    sent += 40;
    second_->create(shared(id));
  }
  EXPECT_EQ(misses(reader, instances, sent), "");
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 0u);
}

TEST_F(TwoHosts, RejectACommandOnWhichTheOtherHostsDriverThrowsAndKeepTheRest) {
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  first_->create(shared("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  second_->create(spec("b", {{"shared", "true"}, {"throw_in", "message"}}));
  ASSERT_TRUE(log_.wait_for("b", DriverState::active));
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  send_to(sender, {"b"}, 0, 10);
  ASSERT_TRUE(log_.wait_for("b", DriverState::failed));
  second_->create(shared("b"));
  for (int i = 1; i < 10; ++i) ASSERT_EQ(next_echo(reader), std::to_string(i));
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 1u);
}

TEST_F(TwoHosts, KeepEachOthersCommandsWhileTheGatewayIsAway) {
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  first_->create(shared("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  second_->create(shared("b"));
  gateway_ = Gateway::away;
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  send_to(sender, {"b", "a"}, 0, 1);
  ASSERT_EQ(next_echo(reader), "0");
  clock_.advance(SharedChannels::longest_wait - 1ms);
  sender.send("1", "a");
  ASSERT_EQ(next_echo(reader), "1");
  gateway_ = Gateway::passes;
  ASSERT_EQ(next_echo(reader), "0");
  EXPECT_EQ(count("iotcloud_driver_lost_total"), 0u);
}

TEST_F(TwoHosts, PassAgainWhatAGatewayThatEndedHadInHand) {
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  first_->create(shared("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  second_->create(shared("b"));
  gateway_ = Gateway::forgets;
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  send_to(sender, {"b"}, 0, 3);
  ASSERT_TRUE(tests::eventually([&] { return forgotten_ > 0; }));
  gateway_ = Gateway::passes;
  first_->nobody_answers();
  for (const char* expected : {"0", "1", "2"}) ASSERT_EQ(next_echo(reader), expected);
}

class SpooledChannelTest : public DriverHostTest {
 protected:
  SpooledChannelTest() {
    std::string name = (std::filesystem::temp_directory_path() / "iotcloud-state-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("cannot make " + name);
    state_folder_ = name;
  }
  ~SpooledChannelTest() override {
    host_.reset();
    std::filesystem::remove_all(state_folder_);
  }
  InstanceSpec spooled(const std::string& id, std::map<std::string, std::string> more = {}) {
    more["channel.readings.when_full"] = "spool";
    return spec(id, std::move(more));
  }
};

TEST_F(SpooledChannelTest, WhatNobodyHasReadWhenAnInstanceEndsIsSentByItsNextLife) {
  start_host(probe_);
  host_->create(spooled("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  host_->remove("a"_instance, Removal::undeployed);
  ASSERT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_TRUE(std::filesystem::exists(state_folder_ + "/spool/a/readings"));
  host_->create(spooled("a"));
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  const auto first = reader.next();
  const auto second = reader.next();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->payload.text(), "up");
  EXPECT_EQ(second->payload.text(), "up");
  EXPECT_LE(first->time_ms, second->time_ms);
  ASSERT_TRUE(tests::eventually([&] { return count("iotcloud_driver_channel_waiting") == 0; })) << "it knows so";
  host_->remove("a"_instance, Removal::undeployed);
  host_.reset();
  EXPECT_FALSE(std::filesystem::exists(state_folder_ + "/spool/a")) << "nothing is left when all was sent";
}

TEST_F(SpooledChannelTest, AnInstanceThatIsRemovedTwiceEndsOnce) {
  start_host(probe_);
  host_->create(spooled("a"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  host_->remove("a"_instance, Removal::undeployed);
  host_->remove("a"_instance, Removal::undeployed);  // its spool is still being closed
  host_.reset();
  const auto states = log_.states("a");
  EXPECT_EQ(std::count(states.begin(), states.end(), DriverState::stopping), 1);
}

TEST_F(SpooledChannelTest, AnInstanceThatFailedGoesOnWithItsSpoolAtOnce) {
  start_host(probe_);
  host_->create(spooled("a", {{"throw_in", "message"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  MessageSender(url_, {"probe", "gw.probe.a.control", false}).send("throw", "a");
  ASSERT_TRUE(log_.wait_for("a", DriverState::failed));
  host_->create(spooled("a"));
  MessageLog reader(url_, {"probe", "gw.probe.a.readings", false});
  ASSERT_TRUE(reader.next());
  ASSERT_TRUE(reader.next());
}

TEST_F(SpooledChannelTest, AnInstanceThatOpensItsSpoolHoldsNoOtherUp) {
  std::promise<void> go_on;
  const tests::LockCalls slow([let_go = go_on.get_future().share()] { let_go.wait(); });
  start_host(probe_);
  host_->create(spooled("a"));
  host_->create(spec("b"));
  EXPECT_TRUE(log_.wait_for("b", DriverState::active));
  EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::starting));
  go_on.set_value();
  EXPECT_TRUE(log_.wait_for("a", DriverState::active));
}

TEST_F(SpooledChannelTest, AnInstanceThatIsRemovedWhileItOpensItsSpoolLetsGoOfItBeforeItsEndIsReported) {
  std::promise<void> go_on;
  {
    const tests::LockCalls slow([let_go = go_on.get_future().share()] { let_go.wait(); });
    start_host(probe_);
    host_->create(spooled("a"));
    host_->remove("a"_instance, Removal::replaced);
    EXPECT_TRUE(log_.wait_for("a", DriverState::stopping));
    EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::starting, DriverState::stopping));
    go_on.set_value();
    EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  }
  host_->create(spooled("a"));
  EXPECT_TRUE(log_.wait_for("a", DriverState::active));
}

TEST_F(SpooledChannelTest, AnInstanceThatFailsWhileItsSpoolIsSyncedHoldsNoOtherUp) {
  std::promise<void> go_on;
  std::atomic<bool> syncing{false};
  const tests::SyncCalls slow([&, let_go = go_on.get_future().share()](const std::string& path) {
    if (path.starts_with(state_folder_)) {
      syncing = true;
      let_go.wait();
    }
    return 0;
  });
  start_host(probe_);
  host_->create(spooled("a", {{"throw_in", "message"}, {"channel.readings.spool_fsync", "always"}}));
  EXPECT_TRUE(tests::eventually([&] { return syncing.load(); }));
  MessageSender(url_, {"probe", "gw.probe.a.control", false}).send("throw", "a");
  EXPECT_TRUE(tests::eventually([&] { return count("iotcloud_driver_lost_total") == 1; })) << "a has failed";
  host_->create(spec("b"));
  EXPECT_TRUE(log_.wait_for("b", DriverState::active));
  EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::starting, DriverState::active))
      << "a failure is known when the spool is free for the next life";
  host_->remove("a"_instance, Removal::undeployed);
  go_on.set_value();
  EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_THAT(log_.states("a"),
              ElementsAre(DriverState::starting, DriverState::active, DriverState::failed, DriverState::undeployed));
}

TEST_F(SpooledChannelTest, ADriverIsToldWhatIsOnTheDisk) {
  start_host(probe_);
  host_->create(spooled("a", {{"channel.readings.spool_fsync", "always"}}));
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  EXPECT_TRUE(tests::eventually([&] {
    const auto all = host_->list();
    const auto& metadata = all.front().status.metadata;
    const auto stored = metadata.find("stored");
    return stored != metadata.end() && stored->second == "readings 1";
  }));
}

TEST_F(SpooledChannelTest, WithoutAStateFolderASpooledChannelIsRefusedWithWhatToDo) {
  const std::string folder = std::exchange(state_folder_, "");
  start_host(probe_);
  host_->create(spooled("a"));
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("no state folder"));
  state_folder_ = folder;
}

TEST_F(DriverHostTest, ASharedIncomingChannelNeedsAllInstancesInOneHost) {
  DriverHost::Options options;
  options.gateway = "gw"_gateway;
  options.isolated = true;
  host_.emplace(options, Plugin::wrap(probe_, "linked in"), [this](const auto& status) { log_.add(status); });
  host_->create(spec("a", {{"shared", "true"}, {"isolation", "instance"}}));
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("channel.control.shared=false"));
}

class AThrow : public DriverHostTest, public ::testing::WithParamInterface<const char*> {};

TEST_P(AThrow, CostsItsInstanceAndNoOther) {
  const std::string where = GetParam();
  start_host(probe_);
  host_->create(spec("good"));
  host_->create(spec("bad", {{"throw_in", where}}));
  std::optional<MessageSender> to_bad;
  if (where == "message") {
    to_bad.emplace(url_, brokers::Topic{"probe", "gw.probe.bad.control", false});
    to_bad->send("x", "bad");
  }
  const auto failed = log_.wait_for("bad", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("told to throw in " + where));
  EXPECT_TRUE(failed->channels.empty());

  MessageLog reader(url_, {"probe", "gw.probe.good.readings", false});
  ASSERT_TRUE(reader.next());
  MessageSender sender(url_, {"probe", "gw.probe.good.control", false});
  sender.send("still there?", "good");
  ASSERT_TRUE(reader.next());

  host_->create(spec("bad"));  // a failed one may be made anew
  EXPECT_TRUE(log_.wait_for("bad", DriverState::active));
}

INSTANTIATE_TEST_SUITE_P(Everywhere, AThrow, ::testing::Values("channels", "open", "activate", "timer", "message"));

TEST_F(DriverHostTest, PublishingOnAChannelThatWasNotDeclaredFailsTheInstanceAndNamesTheChannels) {
  start_host(probe_);
  host_->create(spec("a", {{"publishes_on", "reading"}}));
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_EQ(failed->reason, "publish: there is no outgoing channel \"reading\"; channels() declares \"readings\"");
}

TEST_F(DriverHostTest, APropertyThatCannotBeFailsTheInstanceNamingIt) {
  start_host(probe_);
  host_->create(spec("a", {{"channel.readings.capacity", "many"}}));
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("channel.readings.capacity"));
}

TEST_F(DriverHostTest, AThreadThatIsStuckIsNamedWithTheInstanceWhoseCallbackRuns) {
  BlockingDriver::go_on = {};
  start_host(blocking_);
  host_->create(spec("idle"));
  ASSERT_TRUE(log_.wait_for("idle", DriverState::active));
  host_->create(spec("a", {{"block", "yes"}, {"hang_limit", "7s"}}));
  std::vector<Stall> stalls;
  ASSERT_TRUE(tests::eventually([&] {
    stalls = host_->stalls();
    return !stalls.empty() && !stalls[0].instance.empty();
  }));
  EXPECT_EQ(stalls.size(), 1u);
  EXPECT_EQ(stalls[0].instance, "a");
  EXPECT_FALSE(stalls[0].own_thread);
  EXPECT_EQ(stalls[0].limit, 7s);
  BlockingDriver::go_on.set_value();
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  EXPECT_TRUE(tests::eventually([&] { return host_->stalls().empty(); }));
}

TEST_F(DriverHostTest, AnInstanceThatIsStuckOnItsOwnThreadIsNamedToo) {
  BlockingDriver::go_on = {};
  start_host(blocking_);
  host_->create(spec("b"));
  host_->create(spec("a", {{"block", "yes"}, {"thread", "own"}, {"hang_limit", "never"}}));
  std::vector<Stall> stalls;
  ASSERT_TRUE(tests::eventually([&] {
    stalls = host_->stalls();
    return !stalls.empty() && stalls[0].own_thread;
  }));
  EXPECT_EQ(stalls[0].instance, "a");
  EXPECT_EQ(stalls[0].limit, 0s);
  BlockingDriver::go_on.set_value();
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
}

TEST_F(DriverHostTest, AHangLimitThatIsNoTimeFailsTheInstance) {
  start_host(probe_);
  host_->create(spec("a", {{"hang_limit", "soon"}}));
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("hang_limit: \"soon\" is no time"));
}

TEST_F(DriverHostTest, AnInstanceWithItsOwnThreadMayBlockWithoutHoldingOthersUp) {
  BlockingDriver::go_on = {};
  start_host(blocking_);
  host_->create(spec("a", {{"block", "yes"}, {"thread", "own"}}));
  host_->create(spec("b"));
  EXPECT_TRUE(log_.wait_for("b", DriverState::active));
  EXPECT_THAT(log_.states("a"), ::testing::Not(::testing::Contains(DriverState::active)));
  BlockingDriver::go_on.set_value();
  EXPECT_TRUE(log_.wait_for("a", DriverState::active));
}

TEST_F(DriverHostTest, StoppingRemovesEveryInstance) {
  start_host(probe_);
  for (const std::string id : {"a", "b", "c"}) host_->create(spec(id));
  EXPECT_TRUE(host_->stop(120s));
  for (const std::string id : {"a", "b", "c"}) EXPECT_EQ(log_.states(id).back(), DriverState::undeployed) << id;
  host_->create(spec("d"));
  EXPECT_TRUE(host_->list().empty());
}

TEST_F(DriverHostTest, RemovingAnUnknownInstanceIsAnsweredAtOnce) {
  start_host(probe_);
  host_->remove("never seen"_instance, Removal::undeployed);
  EXPECT_TRUE(log_.wait_for("never seen", DriverState::undeployed));
}

}  // namespace
}  // namespace iotcloud::gateway
