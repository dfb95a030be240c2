// Which plugins orders name, and so which are kept.
#include <future>

#include <iotcloud/gateway/ordered_instances.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>

namespace iotcloud::gateway {
namespace {

using ::testing::UnorderedElementsAre;

class PluginsNamedTest : public GatewayFixture {
 protected:
  PluginsNamedTest() {
    const auto wanted = options();
    instances_ = std::make_unique<OrderedInstances>(
        OrderedInstances::Options{"gw"_gateway, registry_.get(), paths_, launcher_.get(), wanted.brokers,
                                  wanted.restart, &config::system_clock(), ""},
        loop_);
  }
  ~PluginsNamedTest() override {
    loop_.stop();
    instances_.reset();
  }
  template <typename Action>
  auto on_loop(Action&& action) {
    std::promise<decltype(action())> done;
    auto result = done.get_future();
    loop_.post([&] { done.set_value(action()); });
    return result.get();
  }
  using Named = std::optional<std::set<std::string>>;
  Named named() {
    return on_loop([&] { return instances_->plugins_named(); });
  }
  Named first(const std::set<discovery::InstanceId>& orders) {
    return on_loop([&] {
      instances_->ordered_at_first(orders);
      return instances_->plugins_named();
    });
  }
  Named follow(const discovery::OrderRecord& order, std::int64_t version) {
    return on_loop([&] {
      instances_->follow(order, version);
      return instances_->plugins_named();
    });
  }

  const std::shared_ptr<HostLauncher> launcher_ = new_launcher();
  EventLoop loop_{"test"};
  std::unique_ptr<OrderedInstances> instances_;
};

TEST_F(PluginsNamedTest, NothingIsSaidBeforeAllOrdersThatStoodAtTheStartAreRead) {
  EXPECT_FALSE(named());
  EXPECT_FALSE(first({"a"_instance, "b"_instance}));
  auto one = order("a");
  one.sha256 = std::string(64, 'a');
  EXPECT_FALSE(follow(one, 0));
  EXPECT_THAT(*follow(order("b"), 0), UnorderedElementsAre("", one.sha256));
}

TEST_F(PluginsNamedTest, WhatAnUpdateMayGoBackToIsNamedUntilItIsOver) {
  EXPECT_TRUE(first({}));
  auto one = order("a");
  one.sha256 = std::string(64, 'a');
  one.previous = discovery::PluginVersion{"probe.so", std::string(64, 'b')};
  EXPECT_THAT(*follow(one, 0), UnorderedElementsAre(one.sha256, one.previous->sha256));
  one.previous.reset();
  EXPECT_THAT(*follow(one, 1), UnorderedElementsAre(one.sha256));
}

}  // namespace
}  // namespace iotcloud::gateway
