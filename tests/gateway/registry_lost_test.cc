// A gateway whose registry comes back empty, in an earlier state, or with another gateway in its place.
#include <atomic>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::HasSubstr;

/// Says that it has no connection as often as the test wants.
class DisconnectedRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;
  discovery::SessionState session() const override {
    if (times == 0) return PassingRegistry::session();
    --times;
    return discovery::SessionState::connecting;
  }
  mutable std::atomic<int> times{0};  ///< only the gateway's loop counts it down
};

/// Is emptied each time it has created a node at `path`, as often as the test wants.
class EmptiedRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;
  void create(const std::string& at, const std::string& data, bool parents, const Fence& fence) override {
    PassingRegistry::create(at, data, parents, fence);
    if (at != path || times == 0) return;
    --times;
    server->put_back(nullptr);
  }
  std::shared_ptr<discovery::embedded::RegistryServer> server;
  std::string path;
  std::atomic<int> times{0};  ///< only the gateway's loop counts it down
};

class RegistryLost : public GatewayFixture {
 protected:
  RegistryLost() : own_(new_quick_session()) { registry_ = new_quick_session(); }
  ~RegistryLost() override { gateway_.reset(); }  // before the registry that it uses

  std::unique_ptr<discovery::Registry> new_quick_session() const {
    discovery::RegistryOptions quick;
    quick.url = registry_url_;
    quick.session_timeout = std::chrono::milliseconds{50};
    return discovery::make_registry(quick);
  }
  void start() {
    auto with = options();
    with.registry = own_.get();
    with.state_id = "this folder";
    with.retry_pause = std::chrono::milliseconds{5};
    with.on_replaced = [this](const std::string&) { replaced_ = true; };
    gateway_.emplace(std::move(with));
    gateway_->start();
  }
  void start_with(const std::string& instance) {
    start();
    give(order(instance));
    ASSERT_TRUE(comes_to(instance, DriverState::active));
  }
  bool is_there(const std::string& path) { return registry_->get(path).has_value(); }
  bool registers_again() {
    return eventually([&] {
      const auto record = registry_->get(paths_.gateway("gw"_gateway));
      return record && !record->data.empty() && is_there(paths_.gateway_alive("gw"_gateway));
    });
  }
  bool is_frozen() {
    return eventually([&] { return is_there(mark_) && !gateway_->trouble().empty(); });
  }
  void adopt() {
    const auto freeze = discovery::decode_freeze(registry_->get(mark_)->data, mark_);
    discovery::put(*registry_, paths_.orders("gw"_gateway), encode(discovery::Adoption{freeze.token, 1}));
  }
  std::size_t instances() const { return gateway_->instances().size(); }

  const std::string mark_ = discovery::freeze_path(paths_, "gw"_gateway);
  const std::shared_ptr<discovery::embedded::RegistryServer> server_ =
      discovery::embedded::RegistryServer::named(name_);
  std::unique_ptr<discovery::Registry> own_;
  std::atomic<bool> replaced_{false};
};

TEST_F(RegistryLost, AnEmptiedRegistryStopsNothingAndGetsTheRecordsAgain) {
  start_with("a");
  const auto before = record("a");
  server_->put_back(nullptr);
  EXPECT_TRUE(registers_again());
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_EQ(record("a"), before) << "it was not restarted";
  EXPECT_TRUE(is_there(paths_.channel("probe"_driver, "a"_instance, "readings")));
  EXPECT_TRUE(is_frozen());
  EXPECT_THAT(gateway_->trouble(), HasSubstr("iotcloud registry adopt gw"));
  give(order("b"));
  adopt();
  EXPECT_TRUE(comes_to("b", DriverState::active)) << "what was ordered meanwhile is followed after the adoption";
  EXPECT_TRUE(eventually([&] { return !record("a"); })) << "it is not ordered any more, as somebody confirmed";
  EXPECT_TRUE(eventually([&] { return !is_there(mark_) && gateway_->trouble().empty(); }));
}

TEST_F(RegistryLost, AGatewaysNodeThatSomebodyRemovesComesBack) {
  start_with("a");
  const auto session = registry_->get(paths_.gateway_alive("gw"_gateway))->owner_session;
  server_->partition(session);  // so that the gateway sees nothing of it before all is gone
  discovery::remove_tree(*registry_, paths_.gateway("gw"_gateway));
  server_->restore(session);
  EXPECT_TRUE(registers_again());
  EXPECT_TRUE(is_frozen());
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_EQ(instances(), 1U);
}

TEST_F(RegistryLost, ARegistryInAnEarlierStateStopsNothing) {
  start_with("a");
  const auto backup = server_->image();
  give(order("b"));
  ASSERT_TRUE(comes_to("b", DriverState::active));
  server_->put_back(backup);
  EXPECT_TRUE(registers_again());
  EXPECT_TRUE(is_frozen());
  EXPECT_TRUE(comes_to("b", DriverState::active));
  adopt();
  EXPECT_TRUE(eventually([&] { return !record("b"); }));
  EXPECT_EQ(record("a")->state, DriverState::active);
}

TEST_F(RegistryLost, AnIdleGatewayOfAnEmptiedRegistryTakesOrders) {
  start();
  server_->put_back(nullptr);
  EXPECT_TRUE(registers_again());
  give(order("a"));
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
}

TEST_F(RegistryLost, AnIdleGatewayTakesOrdersOfARegistryThatIsEmptiedWhileItReadsThem) {
  auto registry = std::make_unique<EmptiedRegistry>(new_quick_session());
  auto& emptied = *registry;
  emptied.server = server_;
  emptied.path = paths_.orders("gw"_gateway);
  emptied.times = 2;
  own_ = std::move(registry);
  start();
  EXPECT_TRUE(eventually([&] { return emptied.times == 0; }));
  EXPECT_TRUE(registers_again());
  give(order("a"));
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
}

TEST_F(RegistryLost, AGatewayThatIsNotRegisteredIsNotHealthy) {
  auto with = options();
  with.registry = own_.get();
  with.retry_pause = std::chrono::hours{1};  // it stays unregistered
  gateway_.emplace(std::move(with));
  EXPECT_THAT(gateway_->trouble(), HasSubstr("has not registered yet"));
  gateway_->start();
  EXPECT_EQ(gateway_->trouble(), "");
  registry_->remove(paths_.gateway_alive("gw"_gateway));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().find("not registered any more") != std::string::npos; }));
}

TEST_F(RegistryLost, AGatewayWhosePlaceAnotherOneHasTakenEndsItsHosts) {
  own_ = new_session();  // which is not renewed by itself before another one has its place
  start_with("a");
  const auto session = registry_->get(paths_.gateway_alive("gw"_gateway))->owner_session;
  server_->partition(session);
  server_->expire(session);
  const auto other = registry_->hold(paths_.gateway_alive("gw"_gateway),
                                     encode(discovery::GatewayLife{"lab2", 12905, 7, "its folder", "its run"}));
  const auto its_record = record("a");
  server_->restore(session);
  EXPECT_TRUE(eventually([&] { return replaced_.load(); }));
  EXPECT_THAT(gateway_->trouble(), HasSubstr("another gateway with the id \"gw\" is alive (lab2:12905)"));
  EXPECT_EQ(gateway_->instances().at(0).state, DriverState::inactive);
  EXPECT_EQ(record("a"), its_record) << "what it says is the other gateway's business";
  EXPECT_THAT(registry_->get(paths_.gateway_alive("gw"_gateway))->data, HasSubstr("lab2"));
}

TEST_F(RegistryLost, TheMarkOfAnEarlierRunOfThisGatewayEndsNothing) {
  own_ = new_session();  // which is not renewed by itself before another one has its place
  start_with("a");
  const auto session = registry_->get(paths_.gateway_alive("gw"_gateway))->owner_session;
  server_->partition(session);
  server_->expire(session);
  // As a backup of the registry has it, until the session of that run expires.
  auto mark = registry_->hold(paths_.gateway_alive("gw"_gateway),
                              encode(discovery::GatewayLife{"lab1", 12905, 7, "this folder", "an earlier run"}));
  server_->restore(session);
  give(order("b"));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  mark.reset();
  EXPECT_TRUE(eventually([&] {
    const auto alive = registry_->get(paths_.gateway_alive("gw"_gateway));
    return alive && alive->data.find("an earlier run") == std::string::npos;
  }));
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_FALSE(replaced_);
}

TEST_F(RegistryLost, AMarkOfLifeThatSomebodyRemovesComesBackAlsoAfterALossOfTheConnection) {
  auto registry = std::make_unique<DisconnectedRegistry>(new_quick_session());
  auto& disconnected = *registry;
  own_ = std::move(registry);
  start();
  disconnected.times = 3;
  registry_->remove(paths_.gateway_alive("gw"_gateway));
  EXPECT_TRUE(eventually([&] { return disconnected.times == 0; }));
  EXPECT_TRUE(eventually([&] { return is_there(paths_.gateway_alive("gw"_gateway)); }));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
}

TEST_F(RegistryLost, AnInstanceWithALeaseStopsWhileTheRegistryIsAwayAndStartsAgain) {
  start_with("a");
  give(order("leased", {{"on_partition", "stop"}, {"lease", "100ms"}}));
  ASSERT_TRUE(comes_to("leased", DriverState::active));
  const auto here = [this](const std::string& instance, DriverState state, const std::string& reason) {
    for (const auto& record : gateway_->instances()) {
      if (record.instance == discovery::InstanceId(instance))
        return record.state == state && record.reason.find(reason) == 0;
    }
    return false;
  };
  server_->stop();
  EXPECT_TRUE(eventually([&] { return here("leased", DriverState::inactive, "stopped: no lease since"); }));
  EXPECT_TRUE(here("a", DriverState::active, ""));
  server_->start();
  EXPECT_TRUE(eventually([&] { return here("leased", DriverState::active, ""); }));
}

TEST_F(RegistryLost, ALeaseShorterThanTheSessionIsRefused) {
  start();
  auto wanted = order("a", {{"on_partition", "stop"}, {"lease", "50ms"}});
  wanted.driver = "probe"_driver;  // the record of a refused order is found by it
  give(wanted);
  EXPECT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason, HasSubstr("give at least that"));
}

TEST_F(RegistryLost, ARegistryThatIsAwayEndsNothing) {
  start_with("a");
  server_->stop();
  ASSERT_TRUE(eventually([&] { return server_->is_asked(); }));  // the session's time is over
  server_->start();
  give(order("b"));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
  EXPECT_FALSE(replaced_);
}

}  // namespace
}  // namespace iotcloud::gateway
