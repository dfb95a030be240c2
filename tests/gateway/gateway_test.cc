#include <map>
#include <string>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/gateway/message_log.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

class GatewayTest : public GatewayFixture {};

/// Calls `written` with each node that was created or set, before the caller goes on.
class WatchedRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;
  void create(const std::string& path, const std::string& data, bool parents, const Fence& fence) override {
    PassingRegistry::create(path, data, parents, fence);
    written(path, data);
  }
  void set(const std::string& path, const std::string& data, std::int64_t version, const Fence& fence) override {
    PassingRegistry::set(path, data, version, fence);
    written(path, data);
  }
  std::function<void(const std::string& path, const std::string& data)> written;
};

TEST_F(GatewayTest, ItRegistersAndIsAliveUntilItStops) {
  start_gateway();
  const auto path = paths_.gateway("gw"_gateway);
  const auto record = discovery::decode_gateway(registry_->get(path)->data, path);
  EXPECT_EQ(record.id, "gw");
  EXPECT_EQ(record.port, 12905);
  EXPECT_THAT(record.brokers, ::testing::ElementsAre("local"));
  EXPECT_TRUE(registry_->get(paths_.gateway_alive("gw"_gateway))->ephemeral);
  gateway_->stop(20s);
  EXPECT_FALSE(registry_->get(paths_.gateway_alive("gw"_gateway)));
}

TEST_F(GatewayTest, ItsRecordSaysWhatItsDriversCannotDoAsLongAsThatIsSo) {
  start_gateway();
  const auto path = paths_.gateway("gw"_gateway);
  const auto shown = [&] { return discovery::decode_gateway(registry_->get(path)->data, path).trouble; };
  EXPECT_EQ(shown(), "");
  gateway_->show_trouble("the broker local is away");
  EXPECT_TRUE(tests::eventually([&] { return shown() == "the broker local is away"; })) << shown();
  gateway_->show_trouble("");
  EXPECT_TRUE(tests::eventually([&] { return shown().empty(); })) << shown();
}

TEST_F(GatewayTest, AnOrderBecomesAnActiveInstanceWithItsRecords) {
  start_gateway();
  auto wanted = order("a");
  wanted.metadata = {{"room", "7"}};
  give(wanted);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto driver = record("a");
  EXPECT_EQ(driver->gateway, "gw");
  EXPECT_EQ(driver->metadata, wanted.metadata);
  EXPECT_GT(driver->since_ms, 0);
  ASSERT_EQ(driver->channels.size(), 2u);
  const auto path = paths_.channel("probe"_driver, "a"_instance, "readings");
  const auto channel = discovery::decode_channel(registry_->get(path)->data, path);
  EXPECT_EQ(channel, driver->channels.at(0));
  EXPECT_EQ(channel.broker_url, broker_url_);
}

TEST_F(GatewayTest, WhoSeesTheRecordOfAnActiveInstanceHearsTheSameFromTheGateway) {
  WatchedRegistry watched(new_session());
  auto with = options();
  with.registry = &watched;
  gateway_.emplace(std::move(with));
  std::atomic<int> heard{0};
  std::atomic<int> seen{0};
  watched.written = [&, &gateway = *gateway_](const std::string& path, const std::string& data) {
    if (path != paths_.instance("probe"_driver, "a"_instance)) return;
    if (discovery::decode_driver(data, path).state != DriverState::active) return;
    for (const auto& instance : gateway.instances()) heard += instance.state == DriverState::active ? 1 : 0;
    ++seen;  // last, because the test then ends the gateway
  };
  gateway_->start();
  give(order("a"));
  EXPECT_TRUE(eventually([&] { return seen > 0; }));
  gateway_.reset();
  EXPECT_EQ(heard, seen);
}

TEST_F(GatewayTest, TakingTheOrderBackRemovesTheInstanceAndItsRecords) {
  start_gateway();
  give(order("a"));
  give(order("b"));
  ASSERT_TRUE(comes_to("a", DriverState::active) && comes_to("b", DriverState::active));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_EQ(record("b")->state, DriverState::active);
  take_back("b");
  EXPECT_TRUE(eventually([&] { return !registry_->get(paths_.driver("probe"_driver)); }));
}

TEST_F(GatewayTest, AnInstanceIsStoppedAndStartedAsOrdered) {
  start_gateway();
  auto wanted = order("a");
  give(wanted);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  wanted.active = false;
  give(wanted);
  EXPECT_TRUE(comes_to("a", DriverState::inactive));
  wanted.active = true;
  give(wanted);
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(GatewayTest, AnInstanceThatThrowsIsFailedForItsReasonAndHasNoChannels) {
  start_gateway();
  give(order("good"));
  give(order("bad", {{"throw_in", "timer"}}));
  ASSERT_TRUE(comes_to("bad", DriverState::failed));
  EXPECT_THAT(record("bad")->reason, HasSubstr("told to throw in timer"));
  EXPECT_TRUE(
      eventually([&] { return registry_->children(paths_.instance("probe"_driver, "bad"_instance))->empty(); }));
  EXPECT_TRUE(comes_to("good", DriverState::active));
}

TEST_F(GatewayTest, TheRecordOfAFailedInstanceSaysWhetherItStartsAgainByItself) {
  auto with = options();
  with.restart.first = std::chrono::hours{1};  // the state stays to be seen
  gateway_.emplace(std::move(with));
  gateway_->start();
  give(order("waits", {{"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("waits", DriverState::failed));
  EXPECT_TRUE(record("waits")->starts_again);
  give(order("waits"));
  ASSERT_TRUE(comes_to("waits", DriverState::active));
  EXPECT_FALSE(record("waits")->starts_again);

  give(order("waits", {{"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("waits", DriverState::failed));
  gateway_->stop(std::chrono::seconds{20});
  EXPECT_FALSE(record("waits")->starts_again) << record("waits")->reason;
}

TEST_F(GatewayTest, TheRecordOfAnInstanceThatIsLeftAloneDoesNotSayThatItStartsAgain) {
  auto with = options();
  with.restart.give_up_after = 2;
  gateway_.emplace(std::move(with));
  gateway_->start();
  give(order("a", {{"throw_in", "open"}}));
  EXPECT_TRUE(eventually([&] {
    const auto now = record("a");
    return now && now->reason.find("left alone") != std::string::npos;
  }));
  EXPECT_EQ(record("a")->state, DriverState::failed);
  EXPECT_FALSE(record("a")->starts_again);
}

TEST_F(GatewayTest, OrderingAFailedInstanceAgainStartsItAnew) {
  start_gateway();
  give(order("a", {{"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  give(order("a"));
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(GatewayTest, NewPropertiesReplaceTheInstance) {
  start_gateway();
  give(order("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  give(order("a", {{"shared", "true"}}));
  EXPECT_TRUE(eventually([&] {
    const auto now = record("a");
    return now && now->state == DriverState::active && now->channels.at(0).shared;
  }));
}

TEST_F(GatewayTest, AnOrderTakenBackAndGivenAnewAtOnceIsFollowed) {
  start_gateway();
  give(order("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  take_back("a");
  give(order("a", {{"shared", "true"}}));
  EXPECT_TRUE(eventually([&] {
    const auto now = record("a");
    return now && now->state == DriverState::active && now->channels.at(0).shared;
  }));
}

TEST_F(GatewayTest, APluginOutsideThePluginFolderIsRefused) {
  start_gateway();
  auto wanted = order("a");
  wanted.plugin = "../../tmp/evil.so";
  wanted.driver = "evil"_driver;
  give(wanted);
  ASSERT_TRUE(comes_to("a", DriverState::failed, "evil"));
  EXPECT_THAT(record("a", "evil")->reason, HasSubstr("not a plain file name"));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a", "evil"); }));
}

TEST_F(GatewayTest, ANameThatWouldLeaveItsPlaceInTheRegistryIsRefused) {
  start_gateway();
  auto wanted = order("a");
  wanted.driver = "../gateways"_driver;
  give(wanted);
  ASSERT_TRUE(comes_to("a", DriverState::failed, "unknown"));
  EXPECT_THAT(record("a", "unknown")->reason, HasSubstr("cannot be used as driver name"));
}

TEST_F(GatewayTest, APluginThatIsNotThereFailsItsInstancesAndNoOthers) {
  start_gateway();
  auto wanted = order("a");
  wanted.plugin = "absent.so";
  give(wanted);
  give(order("b"));
  ASSERT_TRUE(comes_to("a", DriverState::failed, "absent"));
  EXPECT_THAT(record("a", "absent")->reason, HasSubstr("absent.so"));
  EXPECT_TRUE(comes_to("b", DriverState::active));
}

TEST_F(GatewayTest, AnOrderOfAnOlderEpochIsIgnored) {
  start_gateway();
  auto newer = order("a");
  newer.epoch = 7;
  give(newer);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  wait_until_it_has_begun();
  auto older = newer;
  older.epoch = 6;
  older.active = false;
  give(older);
  auto newest = order("b");
  newest.epoch = 7;
  give(newest);  // it comes after the older one, and is followed
  ASSERT_TRUE(comes_to("b", DriverState::active));
  EXPECT_EQ(record("a")->state, DriverState::active);
}

TEST_F(GatewayTest, OrdersThatStoodBeforeTheGatewayCameAreFollowedWhateverTheirEpoch) {
  for (const auto& [instance, epoch] : std::map<std::string, std::int64_t>{{"a", 9}, {"b", 2}}) {
    auto wanted = order(instance);
    wanted.epoch = epoch;
    give(wanted);
  }
  start_gateway();
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  EXPECT_EQ(gateway_->epoch(), 9);
}

TEST_F(GatewayTest, OrdersGivenWhileTheRegistryWasOutOfReachAreFollowedWhateverTheirEpoch) {
  const auto server = discovery::embedded::RegistryServer::named(name_);
  ASSERT_TRUE(eventually([&] { return server->sessions().size() == 1; }));
  const auto own = new_session();
  ASSERT_TRUE(eventually([&] { return server->sessions().size() == 2; }));
  const auto session = server->sessions().back();
  auto of_its_own = options();
  of_its_own.registry = own.get();
  gateway_.emplace(std::move(of_its_own));
  gateway_->start();
  give(order("first"));
  ASSERT_TRUE(comes_to("first", DriverState::active));
  server->partition(session);
  // A master led, and another one after it; they are read in the order of their names.
  for (const auto& [instance, epoch] : std::map<std::string, std::int64_t>{{"a", 9}, {"b", 2}}) {
    auto wanted = order(instance);
    wanted.epoch = epoch;
    give(wanted);
  }
  server->restore(session);
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  EXPECT_EQ(gateway_->epoch(), 9);
  gateway_.reset();
}

TEST_F(GatewayTest, AnOrderThatCannotBeReadIsIgnored) {
  start_gateway();
  discovery::put(*registry_, paths_.order("gw"_gateway, "a"_instance), "{no json");
  give(order("b"));
  EXPECT_TRUE(comes_to("b", DriverState::active));
}

TEST_F(GatewayTest, ASecondGatewayOfTheSameIdIsRefused) {
  start_gateway();
  const auto other_session = new_session();
  auto second = options();
  second.registry = other_session.get();
  Gateway twin(std::move(second));
  const tests::CapturedLog log;
  try {
    twin.start();
    FAIL() << "it started";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("another gateway with the id \"gw\" is alive (127.0.0.1:12905)"));
  }
  EXPECT_THAT(log.text(), HasSubstr("the id gw is held by a gateway at 127.0.0.1:12905; this one waits up to 150 ms"));
}

TEST_F(GatewayTest, AStopEndsTheWaitForAnIdThatAnotherOneHasAndLeavesThatOneAlone) {
  start_gateway();
  const auto other_session = new_session();
  auto second = options();
  second.registry = other_session.get();
  second.session_timeout = 1h;
  Gateway twin(std::move(second));
  std::stop_source stop;
  const tests::CapturedLog log;
  std::jthread asks([&] {
    EXPECT_TRUE(eventually([&] { return log.text().find("this one waits up to") != std::string::npos; }));
    stop.request_stop();
  });
  twin.start(stop.get_token());
  twin.stop(20s);
  EXPECT_FALSE(twin.has_joined());
  EXPECT_THAT(twin.trouble(), HasSubstr("not registered: its id is held by a gateway at 127.0.0.1:12905"));
  EXPECT_EQ(gateway_->trouble(), "");
  give(order("a"));
  EXPECT_TRUE(comes_to("a", DriverState::active)) << "the first one follows orders as before";
}

TEST_F(GatewayTest, TheNodeOfItsDeadPredecessorIsTakenOverAtOnce) {
  const auto dead_session = new_session();
  const auto dead =
      dead_session->hold(paths_.gateway_alive("gw"_gateway), R"({"host":"h","port":1,"state":"same folder"})");
  auto second = options();
  second.state_id = "same folder";
  second.session_timeout = 1h;
  gateway_.emplace(std::move(second));
  gateway_->start();
  EXPECT_THAT(registry_->get(paths_.gateway_alive("gw"_gateway))->data, HasSubstr("127.0.0.1"));
}

TEST_F(GatewayTest, AMarkOfLifeThatMakesNoSenseIsThatOfAnotherGateway) {
  for (const std::string mark : {R"({"host":5})", R"({"port":"x"})", "[1", ""}) {
    const auto other_session = new_session();
    const auto other = other_session->hold(paths_.gateway_alive("gw"_gateway), mark);
    gateway_.emplace(options());
    try {
      gateway_->start();
      FAIL() << "it started beside " << mark;
    } catch (const config::Error& e) {
      EXPECT_THAT(e.what(), HasSubstr("another gateway with the id \"gw\" is alive")) << mark;
    }
  }
}

class RecordsOfAnEarlierLife : public GatewayTest {
 protected:
  /// \return its path
  std::string leave(const std::string& driver, const std::string& instance, const std::string& gateway = "gw") {
    discovery::DriverRecord record;
    record.name = discovery::DriverName(driver);
    record.instance = discovery::InstanceId(instance);
    record.gateway = discovery::GatewayId(gateway);
    record.state = DriverState::active;
    const std::string path = paths_.instance(record.name, record.instance);
    discovery::put(*registry_, path, encode(record));
    return path;
  }
};

TEST_F(RecordsOfAnEarlierLife, WithoutOrdersAreRemoved) {
  leave("probe", "old");
  leave("probe", "else", "gw2");
  start_gateway();
  EXPECT_TRUE(eventually([&] { return !record("old"); }));
  EXPECT_TRUE(record("else"));
}

TEST_F(RecordsOfAnEarlierLife, UnderThePluginsNameDoNotStayBesideTheDriversOwn) {
  const std::string path = leave("probe_plugin", "a");
  give(order("a"));
  start_gateway();
  EXPECT_TRUE(eventually(
      [&] { return !registry_->get(path) && registry_->get(paths_.instance("probe"_driver, "a"_instance)); }));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return discovery::list_drivers(*registry_, paths_).empty(); }));
}

TEST_F(GatewayTest, WhenItStopsItsInstancesAreInactiveAndItsOrdersStand) {
  start_gateway();
  give(order("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  gateway_->stop(20s);
  EXPECT_EQ(record("a")->state, DriverState::inactive);
  EXPECT_THAT(record("a")->reason, HasSubstr("gateway was stopped"));
  EXPECT_TRUE(record("a")->channels.empty());
  gateway_.reset();
  start_gateway();
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(GatewayTest, IsolatedInstancesHaveHostsOfTheirOwn) {
  start_gateway();
  give(order("a", {{"isolation", "instance"}}));
  give(order("b", {{"isolation", "instance"}}));
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_EQ(record("b")->state, DriverState::active);
}

TEST_F(GatewayTest, TwoPluginsOfOneDriverBothGetTheirCommandsOnASharedChannel) {
  start_gateway();
  MessageLog reader(broker_url_, {"probe", "gw.probe.readings", false});
  give(order("a", {{"shared", "true"}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  auto other = order("b", {{"shared", "true"}});
  other.plugin = "other.so";
  other.driver = "probe"_driver;
  give(other);
  ASSERT_TRUE(comes_to("b", DriverState::active));
  MessageSender sender(broker_url_, {"probe", "gw.probe.control", false});
  constexpr int commands = 20;
  for (int i = 0; i < commands; ++i) {
    for (const char* instance : {"a", "b"}) sender.send(std::to_string(i), instance);
  }
  std::map<std::string, int> next;
  while (next["a"] < commands || next["b"] < commands) {
    const auto message = reader.next();
    ASSERT_TRUE(message) << next["a"] << " and " << next["b"] << " came";
    if (message->payload.text() == "up") continue;
    ASSERT_EQ(message->payload.text(), std::to_string(next[message->driver_id]++)) << message->driver_id;
  }
}

TEST_F(GatewayTest, ABrokerWithoutServersIsRefused) {
  auto without = options();
  without.brokers.at(0).options.urls.clear();
  EXPECT_THROW(Gateway{std::move(without)}, config::Error);
}

}  // namespace
}  // namespace iotcloud::gateway
