#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/contract_fixture.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::ElementsAre;
using testing::UnorderedElementsAre;

class Directory : public testing::Test {
 protected:
  std::unique_ptr<Registry> client() const { return make_registry({.url = place_->url()}); }

  DriverRecord driver(const std::string& instance, DriverState state) const {
    DriverRecord record;
    record.name = "turtle"_driver;
    record.instance = InstanceId(instance);
    record.gateway = "gw"_gateway;
    record.state = state;
    return record;
  }
  void put_driver(const std::string& instance, DriverState state) {
    put(*writer_, paths_.instance("turtle"_driver, InstanceId(instance)), encode(driver(instance, state)));
  }
  void put_channel(const std::string& instance, const std::string& name, const std::string& broker_url = "amqp://1") {
    ChannelRecord record;
    record.name = name;
    record.transport = "rabbitmq";
    record.driver = "turtle"_driver;
    record.instance = InstanceId(instance);
    record.broker_url = broker_url;
    put(*writer_, paths_.channel("turtle"_driver, InstanceId(instance), name), encode(record));
  }
  /// Records the events of a directory of `channel` in `seen_`.
  std::unique_ptr<DriverDirectory> watch(const std::string& channel) {
    DriverDirectory::Callbacks callbacks;
    callbacks.on_channel = [this](const ChannelRecord& record) {
      seen_.add("+" + record.instance + "." + record.name + "@" + record.broker_url);
    };
    callbacks.on_channel_gone = [this](const ChannelRecord& record) {
      seen_.add("-" + record.instance + "." + record.name);
    };
    return std::make_unique<DriverDirectory>(*registry_, paths_, "turtle"_driver, channel, std::move(callbacks));
  }

  const Paths paths_;
  const std::unique_ptr<Place> place_ = make_place("embedded");
  const std::unique_ptr<Registry> registry_ = client();
  const std::unique_ptr<Registry> writer_ = client();
  Seen<std::string> seen_;
};

TEST_F(Directory, ReportsWhatIsThereAndWhatComesOfOneChannel) {
  put_driver("1", DriverState::active);
  put_channel("1", "kinect");
  put_channel("1", "control");
  const auto directory = watch("kinect");
  ASSERT_TRUE(seen_.wait_for_last("+1.kinect@amqp://1"));
  put_driver("2", DriverState::active);
  put_channel("2", "control");
  put_channel("2", "kinect");
  ASSERT_TRUE(seen_.wait_for_last("+2.kinect@amqp://1"));
  EXPECT_EQ(seen_.all().size(), 2U);
}

TEST_F(Directory, ReportsAllChannelsWhenNoneIsNamed) {
  put_driver("1", DriverState::active);
  put_channel("1", "kinect");
  put_channel("1", "control");
  const auto directory = watch("");
  ASSERT_TRUE(seen_.wait_for_count(2));
  EXPECT_THAT(seen_.all(), UnorderedElementsAre("+1.kinect@amqp://1", "+1.control@amqp://1"));
  writer_->remove(paths_.channel("turtle"_driver, "1"_instance, "control"));
  EXPECT_TRUE(seen_.wait_for_last("-1.control"));
}

TEST_F(Directory, WaitsForADriverThatDoesNotExistYet) {
  const auto directory = watch("kinect");
  put_driver("1", DriverState::active);
  put_channel("1", "kinect");
  EXPECT_TRUE(seen_.wait_for_last("+1.kinect@amqp://1"));
}

TEST_F(Directory, AChannelIsThereOnlyWhileItsDriverIsActive) {
  put_driver("1", DriverState::starting);
  put_channel("1", "kinect");
  const auto directory = watch("kinect");
  put_driver("1", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("+1.kinect@amqp://1"));
  put_driver("1", DriverState::failed);
  ASSERT_TRUE(seen_.wait_for_last("-1.kinect"));
  put_driver("1", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_count(3));
  remove_tree(*writer_, paths_.instance("turtle"_driver, "1"_instance));
  ASSERT_TRUE(seen_.wait_for_count(4));
  EXPECT_THAT(seen_.all(), ElementsAre("+1.kinect@amqp://1", "-1.kinect", "+1.kinect@amqp://1", "-1.kinect"));
}

TEST_F(Directory, AChangedRecordIsReportedAgainAndAnUnchangedOneIsNot) {
  put_driver("1", DriverState::active);
  put_channel("1", "kinect");
  const auto directory = watch("kinect");
  ASSERT_TRUE(seen_.wait_for_count(1));
  put_channel("1", "kinect");
  put_driver("1", DriverState::active);
  put_channel("1", "kinect", "amqp://2");
  ASSERT_TRUE(seen_.wait_for_last("+1.kinect@amqp://2"));
  EXPECT_EQ(seen_.all().size(), 2U);
}

TEST_F(Directory, WhatCannotBeReadIsSkippedUntilItCan) {
  put(*writer_, paths_.instance("turtle"_driver, "1"_instance), "\x0bgarbage");
  put_channel("1", "kinect");
  put_driver("2", DriverState::active);
  put(*writer_, paths_.channel("turtle"_driver, "2"_instance, "kinect"), "garbage");
  put_driver("3", DriverState::active);
  put_channel("3", "kinect");
  const auto directory = watch("kinect");
  ASSERT_TRUE(seen_.wait_for_last("+3.kinect@amqp://1"));
  put_driver("1", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("+1.kinect@amqp://1"));
  put_channel("2", "kinect");
  ASSERT_TRUE(seen_.wait_for_last("+2.kinect@amqp://1"));
  put(*writer_, paths_.channel("turtle"_driver, "2"_instance, "kinect"), "garbage");
  EXPECT_TRUE(seen_.wait_for_last("-2.kinect"));
}

TEST_F(Directory, TakesDriverInstanceAndChannelFromTheRecordsPlaceAndSkipsWhatSaysOthers) {
  const iotcloud::tests::CapturedLog log;
  put_driver("mine", DriverState::active);
  ChannelRecord bare;
  bare.transport = "rabbitmq";
  bare.broker_url = "amqp://1";
  ChannelRecord of_another_instance = bare, of_another_driver = bare, of_another_channel = bare;
  of_another_instance.instance = "victim"_instance;
  of_another_driver.driver = "kinect"_driver;
  of_another_channel.name = "control\nforged line";
  const auto put_at = [&](const std::string& name, const ChannelRecord& record) {
    put(*writer_, paths_.channel("turtle"_driver, "mine"_instance, name), encode(record));
  };
  put_at("a", of_another_instance);
  put_at("b", of_another_driver);
  put_at("c", of_another_channel);
  put_at("d", bare);
  DriverRecord untrue = driver("victim", DriverState::active);
  put(*writer_, paths_.instance("turtle"_driver, "other"_instance), encode(untrue));
  put_channel("other", "d");
  std::vector<ChannelRecord> told;
  DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [&](const ChannelRecord& record) {
    told.push_back(record);
    seen_.add("+" + record.name);
  };
  callbacks.on_channel_gone = [&](const ChannelRecord& record) { seen_.add("-" + record.instance); };
  callbacks.on_record = [&](const InstanceId& instance, const DriverRecord*, bool) { seen_.add("record " + instance); };
  const DriverDirectory directory(*registry_, paths_, "turtle"_driver, "", std::move(callbacks));
  ASSERT_TRUE(seen_.wait_for_last("+d"));
  EXPECT_THAT(seen_.all(), ElementsAre("record mine", "+d"));
  EXPECT_EQ(told.at(0).driver, "turtle");
  EXPECT_EQ(told.at(0).instance, "mine");
  EXPECT_EQ(told.at(0).gateway, "gw");
  EXPECT_TRUE(
      log.contains("skipped: /iot/sensors/turtle/mine/a: the record there says that it is of another instance: "
                   "\"victim\""));
  EXPECT_TRUE(log.contains("of another driver: \"kinect\""));
  EXPECT_TRUE(log.contains("of another channel: \"control\\nforged line\""));
  EXPECT_TRUE(iotcloud::tests::eventually([&] {
    return log.contains("skipped: /iot/sensors/turtle/other: the record there says that it is of another instance");
  }));
  bare.instance = "mine"_instance;
  put_at("a", bare);
  EXPECT_TRUE(seen_.wait_for_last("+a"));
}

TEST_F(Directory, SkipsAChannelOnAnotherGatewayThanItsInstance) {
  put_driver("1", DriverState::active);
  ChannelRecord channel;
  channel.gateway = "another"_gateway;
  const auto path = paths_.channel("turtle"_driver, "1"_instance, "kinect");
  put(*writer_, path, encode(channel));
  put_driver("2", DriverState::active);
  put_channel("2", "kinect");
  const auto directory = watch("kinect");
  ASSERT_TRUE(seen_.wait_for_last("+2.kinect@amqp://1"));
  EXPECT_EQ(seen_.all().size(), 1U);
  channel.gateway = "gw"_gateway;
  put(*writer_, path, encode(channel));
  ASSERT_TRUE(seen_.wait_for_last("+1.kinect@"));
  channel.gateway = "another"_gateway;
  put(*writer_, path, encode(channel));
  EXPECT_TRUE(seen_.wait_for_last("-1.kinect"));
}

TEST_F(Directory, KeepsItsViewThroughAnExpiredSession) {
  put_driver("1", DriverState::active);
  put_channel("1", "kinect");
  const auto directory = watch("kinect");
  ASSERT_TRUE(seen_.wait_for_count(1));
  const auto guard = registry_->hold("/who", "");
  place_->expire(registry_->get("/who")->owner_session);
  put_driver("2", DriverState::active);
  put_channel("2", "kinect");
  ASSERT_TRUE(seen_.wait_for_last("+2.kinect@amqp://1"));
  EXPECT_EQ(seen_.all().size(), 2U);  // no event is repeated or taken back
}

TEST_F(Directory, MayEndInItsOwnCallback) {
  put_driver("1", DriverState::active);
  put_channel("1", "a");
  put_channel("1", "b");
  std::unique_ptr<DriverDirectory> directory;
  std::mutex assigned;
  std::unique_lock lock(assigned);
  DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [&](const ChannelRecord& record) {
    const std::lock_guard wait(assigned);
    directory.reset();
    seen_.add(record.name);
  };
  directory = std::make_unique<DriverDirectory>(*registry_, paths_, "turtle"_driver, "", std::move(callbacks));
  lock.unlock();
  ASSERT_TRUE(seen_.wait_for_count(1));
  const auto other = watch("");
  ASSERT_TRUE(seen_.wait_for_count(3));
  EXPECT_EQ(seen_.all().size(), 3U);
}

TEST_F(Directory, ListsDriversWithTheirChannels) {
  EXPECT_TRUE(list_drivers(*registry_, paths_).empty());
  put_driver("1", DriverState::failed);
  put_channel("1", "kinect");
  put_channel("1", "control");
  put(*writer_, paths_.instance("turtle"_driver, "bad"_instance), "garbage");
  const auto drivers = list_drivers(*registry_, paths_);
  ASSERT_EQ(drivers.size(), 1U);
  EXPECT_EQ(drivers[0].state, DriverState::failed);
  ASSERT_EQ(drivers[0].channels.size(), 2U);
  EXPECT_EQ(drivers[0].channels[0].name, "control");
}

TEST_F(Directory, ListsRecordsAsThoseOfTheirPlacesWhateverTheySay) {
  auto untrue = driver("victim", DriverState::active);
  untrue.name = "kinect"_driver;
  ChannelRecord channel;
  channel.name = "control";
  channel.driver = "kinect"_driver;
  channel.instance = "victim"_instance;
  channel.gateway = "another"_gateway;
  put(*writer_, paths_.channel("turtle"_driver, "mine"_instance, "kinect"), encode(channel));
  put(*writer_, paths_.instance("turtle"_driver, "mine"_instance), encode(untrue));
  untrue.channels = {channel};
  put(*writer_, paths_.instance("turtle"_driver, "other"_instance), encode(untrue));
  const auto drivers = list_drivers(*registry_, paths_);
  ASSERT_EQ(drivers.size(), 2U);
  for (const auto& [one, name] : {std::pair(drivers[0], "kinect"), std::pair(drivers[1], "control")}) {
    EXPECT_EQ(one.name, "turtle");
    ASSERT_EQ(one.channels.size(), 1U);
    EXPECT_EQ(one.channels[0].name, name);
    EXPECT_EQ(one.channels[0].driver, "turtle");
    EXPECT_EQ(one.channels[0].instance, one.instance);
    EXPECT_EQ(one.channels[0].gateway, "gw");
  }
  EXPECT_EQ(drivers[0].instance, "mine");
  EXPECT_EQ(drivers[1].instance, "other");

  GatewayRecord gateway;
  gateway.id = "lab1"_gateway;
  put(*writer_, paths_.gateway("aaa"_gateway), encode(gateway));
  EXPECT_EQ(list_gateways(*registry_, paths_).at(0).record.id, "aaa");
}

TEST_F(Directory, ListsGatewaysAndWhetherTheyLive) {
  for (const char* id : {"a", "b"}) {
    GatewayRecord record;
    record.id = GatewayId(id);
    put(*writer_, paths_.gateway(GatewayId(id)), encode(record));
  }
  const auto alive = writer_->hold(paths_.gateway_alive("b"_gateway), "");
  const auto gateways = list_gateways(*registry_, paths_);
  ASSERT_EQ(gateways.size(), 2U);
  EXPECT_EQ(gateways[0].record.id, "a");
  EXPECT_FALSE(gateways[0].alive);
  EXPECT_TRUE(gateways[1].alive);
}

TEST_F(Directory, ListsTopologiesAndTheirWorkers) {
  TopologyRecord record;
  record.name = "follower"_topology;
  put(*writer_, paths_.topology("follower"_topology), encode(record));
  WorkerRecord worker;
  worker.name = "w1";
  worker.components["decode"] = {2, 4};
  const auto held = writer_->hold(paths_.workers("follower"_topology) + "/w1", encode(worker));
  const auto unreadable = writer_->hold(paths_.workers("follower"_topology) + "/w2", "");
  auto topologies = list_topologies(*registry_, paths_);
  ASSERT_EQ(topologies.size(), 1U);
  EXPECT_EQ(topologies[0].record, record);
  EXPECT_FALSE(topologies[0].order);
  ASSERT_EQ(topologies[0].workers.size(), 2U);
  EXPECT_EQ(topologies[0].workers[0], worker);
  EXPECT_EQ(topologies[0].workers[1].name, "w2");

  TopologyOrder order;
  order.revision = 3;
  order.active = false;
  put(*writer_, paths_.topology_order("follower"_topology), encode(order));
  topologies = list_topologies(*registry_, paths_);
  EXPECT_EQ(topologies.at(0).order, order);
}

TEST_F(Directory, RemovesATopologyWithItsOrdersOnlyWhenNoWorkerIsLeft) {
  TopologyRecord record;
  record.name = "follower"_topology;
  put(*writer_, paths_.topology("follower"_topology), encode(record));
  put(*writer_, paths_.topology_order("follower"_topology), encode(TopologyOrder{}));
  put(*writer_, paths_.ended_workers("follower"_topology) + "/w0", "");
  auto held = writer_->hold(paths_.workers("follower"_topology) + "/w1", "");
  EXPECT_FALSE(remove_topology(*registry_, paths_, "follower"_topology));
  EXPECT_TRUE(registry_->get(paths_.topology_order("follower"_topology)));
  held.reset();
  ASSERT_FALSE(writer_->get(paths_.workers("follower"_topology) + "/w1"));
  EXPECT_TRUE(remove_topology(*registry_, paths_, "follower"_topology));
  EXPECT_FALSE(registry_->get(paths_.topology("follower"_topology)));
  EXPECT_TRUE(remove_topology(*registry_, paths_, "follower"_topology));  // no error when it is gone already
}

TEST_F(Directory, ReportsOfTheInstancesThatAreChosenAsTheyChange) {
  const auto tell = [&](const std::string& instance, const std::string& battery, DriverState state) {
    DriverRecord record = driver(instance, state);
    record.metadata["battery"] = battery;
    put(*writer_, paths_.instance("turtle"_driver, InstanceId(instance)), encode(record));
  };
  DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const ChannelRecord& record) { seen_.add("+" + record.instance); };
  callbacks.on_channel_gone = [this](const ChannelRecord& record) { seen_.add("-" + record.instance); };
  callbacks.on_choice = [this](const InstanceId& instance, std::optional<bool> chosen) {
    seen_.add(instance + (!chosen ? " gone" : *chosen ? " yes" : " no"));
  };
  put_channel("1", "kinect");
  tell("1", "50", DriverState::starting);
  const DriverDirectory directory(*registry_, paths_, "turtle"_driver, "kinect", std::move(callbacks),
                                  Selection::parse("battery > 20"));
  ASSERT_TRUE(seen_.wait_for_last("1 yes"));
  tell("1", "50", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("+1"));
  tell("1", "10", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("-1"));
  tell("1", "30", DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("+1"));
  remove_tree(*writer_, paths_.instance("turtle"_driver, "1"_instance));
  ASSERT_TRUE(seen_.wait_for_last("1 gone"));
  EXPECT_THAT(seen_.all(), ElementsAre("1 yes", "1 yes", "+1", "1 no", "-1", "1 yes", "+1", "-1", "1 gone"));
}

TEST_F(Directory, ReportsTheStatesOfAllInstancesChosenOrNot) {
  const auto tell = [&](DriverState state) {
    put(*writer_, paths_.instance("turtle"_driver, "1"_instance), encode(driver("1", state)));
  };
  DriverDirectory::Callbacks callbacks;
  callbacks.on_record = [this](const InstanceId& instance, const DriverRecord* record, bool) {
    seen_.add(instance + " " + (record ? to_string(record->state) : "gone"));
  };
  tell(DriverState::starting);
  const DriverDirectory directory(*registry_, paths_, "turtle"_driver, "kinect", std::move(callbacks),
                                  Selection::parse("battery > 20"));
  ASSERT_TRUE(seen_.wait_for_last("1 starting"));
  tell(DriverState::active);
  ASSERT_TRUE(seen_.wait_for_last("1 active"));
  tell(DriverState::failed);
  ASSERT_TRUE(seen_.wait_for_last("1 failed"));
  remove_tree(*writer_, paths_.instance("turtle"_driver, "1"_instance));
  ASSERT_TRUE(seen_.wait_for_last("1 gone"));
}

}  // namespace
}  // namespace iotcloud::discovery::tests
