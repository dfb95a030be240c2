#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <gmock/gmock.h>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/fleet/in_process_launcher.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/probe_driver.h>

namespace iotcloud::gateway {

using tests::eventually;

/// A gateway "gw" on an embedded registry and broker of its own. The tests act as a master: they give orders and read
/// records.
class GatewayFixture : public ::testing::Test {
 protected:
  GatewayFixture() { registry_ = new_session(); }

  std::unique_ptr<discovery::Registry> new_session() const {
    discovery::RegistryOptions options;
    options.url = registry_url_;
    return discovery::make_registry(options);
  }

  virtual std::shared_ptr<HostLauncher> new_launcher() {
    InProcessLauncher::Options options;
    options.plugin_dir = "/nonexistent";
    options.linked_in = {{"probe.so", &probe_}, {"other.so", &other_}};
    return std::make_shared<InProcessLauncher>(options);
  }

  GatewayOptions options() {
    GatewayOptions options;
    options.id = "gw"_gateway;
    options.port = 12905;
    options.brokers.push_back({"local", "embedded", {}});
    options.brokers.back().options.urls = {broker_url_};
    options.registry = registry_.get();
    options.launcher = new_launcher();
    options.restart.first = std::chrono::milliseconds{1};
    options.session_timeout = std::chrono::milliseconds{100};
    return options;
  }

  void start_gateway() {
    gateway_.emplace(options());
    gateway_->start();
  }

  /// Waits until the gateway has read what it found at its start: the epoch of an order counts from then on.
  void wait_until_it_has_begun() {
    std::atomic<bool> heard{false};
    const auto behind_its_own = registry_->on_session([&](discovery::SessionState) { heard = true; });
    EXPECT_TRUE(eventually([&] { return heard.load(); }));
    EXPECT_NE(gateway_->ask({}, tests::patience).problem, "") << "behind what its listener has given to its loop";
  }

  discovery::OrderRecord order(const std::string& instance, std::map<std::string, std::string> properties = {}) const {
    discovery::OrderRecord order;
    order.instance = discovery::InstanceId(instance);
    order.plugin = "probe.so";
    order.properties = std::move(properties);
    order.epoch = 1;
    return order;
  }
  void give(const discovery::OrderRecord& order) {
    discovery::put(*registry_, paths_.order("gw"_gateway, order.instance), encode(order));
  }
  void take_back(const std::string& instance) {
    registry_->remove(paths_.order("gw"_gateway, discovery::InstanceId(instance)));
  }

  std::optional<discovery::DriverRecord> record(const std::string& instance, const std::string& driver = "probe") {
    const auto path = paths_.instance(discovery::DriverName(driver), discovery::InstanceId(instance));
    const auto node = registry_->get(path);
    if (!node) return std::nullopt;
    return discovery::decode_driver(node->data, path);
  }
  bool comes_to(const std::string& instance, discovery::DriverState state, const std::string& driver = "probe") {
    return eventually([&] {
      const auto now = record(instance, driver);
      return now && now->state == state;
    });
  }

  /// Waits until an instance's record, which may not be there yet, says this.
  bool comes_to_say(const std::string& instance, const std::string& key, const std::string& value,
                    const std::string& driver = "probe") {
    return eventually([&] {
      auto now = record(instance, driver);
      return now && now->metadata[key] == value;
    });
  }

  static inline std::atomic<int> next_{0};
  const std::string name_ = "gateway-test-" + std::to_string(next_++);
  const std::string registry_url_ = "embedded://" + name_;
  const std::string broker_url_ = "embedded://" + name_;
  const discovery::Paths paths_;
  const drivers::Descriptor probe_ = drivers::describe<ProbeDriver>("probe", "1");
  const drivers::Descriptor other_ = drivers::describe<ProbeDriver>("other", "1");
  std::unique_ptr<discovery::Registry> registry_;
  std::optional<Gateway> gateway_;
};

}  // namespace iotcloud::gateway
