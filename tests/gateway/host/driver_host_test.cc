#include <atomic>
#include <filesystem>
#include <future>
#include <stdexcept>
#include <utility>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/message_log.h>
#include <iotcloud/tests/gateway/probe_driver.h>
#include <iotcloud/tests/gateway/status_log.h>

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

class DriverHostTest : public ::testing::Test {
 protected:
  void start_host(const drivers::Descriptor& descriptor) {
    DriverHost::Options options;
    options.gateway = "gw";
    options.metrics = &metrics_;
    options.drain_limit = 50ms;  // nobody reads most of what these drivers send
    options.state_folder = state_folder_;
    host_.emplace(options, Plugin::wrap(descriptor, "linked in"), [this](const auto& status) { log_.add(status); });
  }

  InstanceSpec spec(const std::string& id, std::map<std::string, std::string> properties = {}) {
    InstanceSpec spec;
    spec.order.instance = id;
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
  EXPECT_EQ(active->channels[0].properties.at("routingKey"), "gw.probe.a.readings");
  host_->deactivate("a");
  host_->activate("a");
  host_->remove("a");
  const auto gone = log_.wait_for("a", DriverState::undeployed);
  ASSERT_TRUE(gone);
  EXPECT_TRUE(gone->channels.empty());
  EXPECT_TRUE(host_->list().empty());
  EXPECT_THAT(log_.states("a"),
              ElementsAre(DriverState::starting, DriverState::active, DriverState::stopping, DriverState::inactive,
                          DriverState::starting, DriverState::active, DriverState::stopping, DriverState::undeployed));
}

TEST_F(DriverHostTest, AnInstanceThatIsOrderedInactiveIsOpenedOnly) {
  start_host(probe_);
  auto inactive = spec("a");
  inactive.order.active = false;
  host_->create(inactive);
  host_->remove("a");
  ASSERT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_THAT(log_.states("a"), ElementsAre(DriverState::starting, DriverState::inactive, DriverState::stopping,
                                            DriverState::undeployed));
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

TEST_F(DriverHostTest, AMessageOnASharedChannelReachesTheInstanceThatItNames) {
  start_host(probe_);
  host_->create(spec("a", {{"shared", "true"}}));
  host_->create(spec("b", {{"shared", "true"}}));
  MessageLog reader(url_, {"probe", "gw.probe.readings", false});
  ASSERT_TRUE(reader.next());
  ASSERT_TRUE(reader.next());
  MessageSender sender(url_, {"probe", "gw.probe.control", false});
  sender.send("nobody", "c");
  sender.send("to b", "b");
  sender.send("to a", "a");
  const auto first = reader.next();
  const auto second = reader.next();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->payload.text(), "to b");
  EXPECT_EQ(first->driver_id, "b");
  EXPECT_EQ(second->payload.text(), "to a");
  EXPECT_EQ(second->driver_id, "a");
  EXPECT_EQ(count("iotcloud_host_messages_for_unknown_instance_total"), 1u);
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
  host_->remove("a");
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
  host_->remove("a");
  host_.reset();
  EXPECT_FALSE(std::filesystem::exists(state_folder_ + "/spool/a")) << "nothing is left when all was sent";
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
  options.gateway = "gw";
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
  EXPECT_TRUE(host_->stop(20s));
  for (const std::string id : {"a", "b", "c"}) EXPECT_EQ(log_.states(id).back(), DriverState::undeployed) << id;
  host_->create(spec("d"));
  EXPECT_TRUE(host_->list().empty());
}

TEST_F(DriverHostTest, RemovingAnUnknownInstanceIsAnsweredAtOnce) {
  start_host(probe_);
  host_->remove("never seen");
  EXPECT_TRUE(log_.wait_for("never seen", DriverState::undeployed));
}

}  // namespace
}  // namespace iotcloud::gateway
