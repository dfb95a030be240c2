#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::gateway {

/// A finder that finds what the test says.
class TestFinder : public drivers::Driver {
 public:
  ~TestFinder() override { leave(); }
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }
  void open(drivers::DriverContext& context) override {
    const config::MutexLock lock(mutex_);
    open_ = &context;
  }
  void close() override { leave(); }
  /// Calls `tell` with the context of the finder, which is open.
  static void with(const std::function<void(drivers::DriverContext&)>& tell) {
    ASSERT_TRUE(eventually([&] {
      const config::MutexLock lock(mutex_);
      if (open_ != nullptr) tell(*open_);
      return open_ != nullptr;
    }));
  }
  static void find(const std::string& id) {
    with([&](auto& context) { context.report_found(id, {{"id", id}, {"says", "id=" + id}}); });
  }

 private:
  static void leave() {
    const config::MutexLock lock(mutex_);
    open_ = nullptr;
  }
  static inline config::Mutex mutex_;
  static inline drivers::DriverContext* open_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;
};

class ProvisioningGatewayTest : public GatewayFixture {
 protected:
  std::shared_ptr<HostLauncher> new_launcher() override {
    InProcessLauncher::Options options;
    options.plugin_dir = "/nonexistent";
    options.linked_in = {{"probe.so", &probe_}, {"finder.so", &finder_}};
    return std::make_shared<InProcessLauncher>(options);
  }
  void start(const std::string& grace = "0s") {
    auto given = options();
    given.provisioned_file = folder_ / "provisioned.jsonl";
    given.provisioning = ProvisioningRules::parse(
        "finders: {eye: {plugin: finder.so}}\n"
        "rules: {probes: {finder: eye, plugin: probe.so, name: 'p-{id}', grace: " +
            grace + ", properties: {says: '{says:text}'}, metadata: {of: '{id}'}}}\n",
        "rules.yaml");
    gateway_.emplace(std::move(given));
    gateway_->start();
    TestFinder::with([](auto& context) { context.report_sight(true); });
  }
  static std::string id(const std::string& name) { return discovery::named_instance_id("gw"_gateway, name, 1).str(); }
  bool gone(const std::string& name) {
    return eventually([&] { return !record(id(name)); });
  }
  discovery::OrderRecord word(const std::string& name, bool active, bool withheld = false) const {
    discovery::OrderRecord word = order(id(name));
    word.made_by = "rule probes";
    word.active = active;
    word.withheld = withheld;
    return word;
  }

  tests::TemporaryFolder folder_;
  const drivers::Descriptor finder_ = drivers::describe<TestFinder>("finder", "1");
};

}  // namespace iotcloud::gateway
