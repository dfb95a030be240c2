#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/master/listing/driver_view.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverRecord;
using discovery::DriverState;
using testing::SizeIs;

/// A view that watches from the first instance on, beside a gateway that writes their records.
class ManyDrivers : public testing::Test {
 protected:
  void put(const std::string& instance, DriverState state, bool with_channel = true) {
    DriverRecord record;
    record.name = "turtle"_driver;
    record.instance = discovery::InstanceId(instance);
    record.gateway = "lab1"_gateway;
    record.state = state;
    if (with_channel) {
      record.channels.emplace_back();
      record.channels.back().name = "kinect";
      record.channels.back().broker_url = "amqp://1";
    }
    discovery::put(*writer, paths.instance("turtle"_driver, discovery::InstanceId(instance)), encode(record));
  }
  bool becomes(const std::string& instance, DriverState state) {
    return test::eventually([&] {
      for (const auto& driver : view.list()) {
        if (driver.instance == instance) return driver.state == state;
      }
      return false;
    });
  }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  const std::unique_ptr<discovery::Registry> writer = test::open_registry(url);
  const std::unique_ptr<discovery::Registry> registry = test::open_registry(url);
  DriverView view{*registry, paths, {0, std::chrono::seconds{20}}};
};

TEST_F(ManyDrivers, AreListedAsADirectReadListsThem) {
  EXPECT_THAT(view.list(), SizeIs(0));
  for (int i = 0; i < 100; ++i) put("i" + std::to_string(i), DriverState::active);
  put("silent", DriverState::failed, false);
  discovery::ChannelRecord channel;
  channel.name = "control";
  channel.broker_url = "amqp://2";
  discovery::put(*writer, paths.channel("turtle"_driver, "silent"_instance, "control"), encode(channel));
  discovery::put(*writer, paths.instance("turtle"_driver, "bad"_instance), "garbage");
  EXPECT_EQ(view.list(), discovery::list_drivers(*registry, paths));
  EXPECT_EQ(view.list(), discovery::list_drivers(*registry, paths)) << "from what is known";
}

TEST_F(ManyDrivers, ComeAndGoAtOnceAndChangesAreSeenSoon) {
  put("a", DriverState::starting);
  put("b", DriverState::active);
  EXPECT_THAT(view.list(), SizeIs(2));
  put("c", DriverState::active);
  EXPECT_THAT(view.list(), SizeIs(3));
  writer->remove(paths.instance("turtle"_driver, "b"_instance));
  EXPECT_THAT(view.list(), SizeIs(2));
  put("a", DriverState::active);
  EXPECT_TRUE(becomes("a", DriverState::active));
  writer->remove(paths.instance("turtle"_driver, "a"_instance));
  EXPECT_THAT(view.list(), SizeIs(1));
  put("a", DriverState::inactive);
  EXPECT_TRUE(becomes("a", DriverState::inactive));
}

TEST_F(ManyDrivers, ThatWereOrderedAreReadAnew) {
  put("a", DriverState::inactive);
  ASSERT_THAT(view.list(), SizeIs(1));
  for (int i = 0; i < 100; ++i) {
    const auto state = i % 2 == 0 ? DriverState::active : DriverState::inactive;
    put("a", state);
    view.ordered("a"_instance);
    ASSERT_EQ(view.list().at(0).state, state) << "what a master has seen done is in the list";
  }
}

/// A registry in which one node keeps this user out: it cannot be read, and a watch of it reports nothing.
class RegistryWithAShutNode final : public iotcloud::tests::PassingRegistry {
 public:
  RegistryWithAShutNode(std::unique_ptr<discovery::Registry> registry, std::string path)
      : PassingRegistry(std::move(registry)), path_(std::move(path)) {}

  std::vector<std::optional<Node>> get_all(const Names& paths) override {
    if (std::find(paths.begin(), paths.end(), path_) == paths.end()) return PassingRegistry::get_all(paths);
    throw discovery::RegistryError(discovery::RegistryErrorCode::denied, path_ + ": it belongs to another user");
  }
  std::vector<std::optional<Node>> get_readable(const Names& paths) override {
    auto nodes = PassingRegistry::get_readable(paths);
    for (std::size_t i = 0; i < paths.size(); ++i) {
      if (paths[i] == path_) nodes[i].reset();
    }
    return nodes;
  }
  discovery::GuardPtr watch_node(const std::string& path,
                                 std::function<void(const std::optional<Node>&)> callback) override {
    return path == path_ ? nullptr : PassingRegistry::watch_node(path, std::move(callback));
  }

 private:
  const std::string path_;
};

TEST_F(ManyDrivers, AreListedWithoutOneThatKeepsMastersOut) {
  put("a", DriverState::active);
  put("b", DriverState::active);
  put("c", DriverState::active);
  RegistryWithAShutNode shut(test::open_registry(url), paths.instance("turtle"_driver, "b"_instance));
  for (const std::size_t few : {0, 256}) {
    DriverView others(shut, paths, {few, std::chrono::milliseconds{1}});
    const auto listed = others.list();
    ASSERT_THAT(listed, SizeIs(2)) << few;
    EXPECT_EQ(listed[0].instance, "a"_instance);
    EXPECT_EQ(listed[1].instance, "c"_instance);
  }
}

TEST_F(ManyDrivers, AreListedAgainAfterTheSessionExpired) {
  const auto server = discovery::embedded::RegistryServer::named(url.substr(std::string("embedded://").size()));
  put("a", DriverState::active);
  ASSERT_THAT(view.list(), SizeIs(1));
  for (const auto session : server->sessions()) server->expire(session);
  put("a", DriverState::failed);
  EXPECT_TRUE(becomes("a", DriverState::failed));
}

}  // namespace
}  // namespace iotcloud::master
