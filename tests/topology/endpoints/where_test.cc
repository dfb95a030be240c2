#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>

namespace iotcloud::topology {
namespace {

using ::testing::ElementsAre;
using Metadata = std::map<std::string, std::string>;

/// Topologies that say `where`.
class Where : public Endpoints {
 protected:
  void tell(const std::string& instance, Metadata metadata,
            discovery::DriverState state = discovery::DriverState::active) {
    discovery::DriverRecord driver = driver_record(instance, state);
    driver.metadata = std::move(metadata);
    put_driver(driver);
  }
  void show(const std::string& instance, Metadata metadata, bool shared = false) {
    for (const bool up : {true, false}) {
      const std::string name = up ? "up" : "down";
      auto channel = channel_record(instance, name, up ? discovery::Direction::out : discovery::Direction::in);
      channel.properties = {{"routingKey", name}};
      channel.shared = shared && up;
      put_channel(channel);
    }
    tell(instance, std::move(metadata));
  }
  static std::string yaml(const std::string& spout_where, const std::string& bolt_where = "") {
    const auto line = [](const std::string& where) { return where.empty() ? "" : "    where: " + where + "\n"; };
    return "topology.name: t\nspouts:\n  in:\n    broker: rabbitmq\n    driver: d\n    channel: up\n" +
           line(spout_where) +
           "    fields: [text, driverID, time]\n    builder: text\nbolts:\n  gate: {class: Gate, inputs: {from: in}}\n"
           "  out:\n    broker: rabbitmq\n    driver: d\n    channel: down\n" +
           line(bolt_where) + "    fields: [text, driverID, time]\n    inputs: {from: gate}\n";
  }
  void start(const std::string& spout_where, const std::string& bolt_where = "") {
    ComponentRegistry components;
    components.add_bolt<GateBolt>("Gate");
    run_yaml(yaml(spout_where, bolt_where), std::move(components));
  }
  bool reads(double channels) {
    return eventually([&] { return metric("iotcloud_spout_channels") == channels; });
  }
};

constexpr const char* in_the_lab = "within(position, 0, 0, 10 m) and battery > 20";

TEST_F(Where, ReadsTheDriversThatAreChosenAndNoOthers) {
  show("near", {{"position", "1,2"}, {"battery", "90"}});
  show("far", {{"position", "100,2"}, {"battery", "90"}});
  show("empty", {{"position", "1,2"}, {"battery", "3"}});
  show("silent", {});
  start(in_the_lab);
  Mailbox down(*broker_, topic("near", "down"));
  ASSERT_TRUE(reads(1));
  device("near")->publish(message("hello", "near"));
  ASSERT_TRUE(down.wait_for(1));
  EXPECT_THAT(down.texts(), ElementsAre("hello"));
}

TEST_F(Where, FollowsADriverThatEntersAndLeaves) {
  show("robot", {{"position", "100,0"}, {"battery", "90"}});
  show("fixed", {{"position", "0,0"}, {"battery", "90"}});
  start(in_the_lab);
  ASSERT_TRUE(reads(1));
  Mailbox down(*broker_, topic("robot", "down"));
  const auto robot = device("robot");
  const auto up = brokers::embedded::Server::named(url_.substr(11));
  for (int round = 0; round < 3; ++round) {
    tell("robot", {{"position", "9,0"}, {"battery", "90"}});
    ASSERT_TRUE(reads(2));
    robot->publish(message("inside " + std::to_string(round), "robot"));
    ASSERT_TRUE(down.wait_for(static_cast<std::size_t>(round) + 1));
    ASSERT_TRUE(eventually([&] { return up.depth(topic("robot", "up"), "t") == 0; }));  // or it would come again
    tell("robot", {{"position", "11,0"}, {"battery", "90"}});
    ASSERT_TRUE(reads(1));
  }
  EXPECT_THAT(down.texts(), ElementsAre("inside 0", "inside 1", "inside 2"));
}

TEST_F(Where, SendsOnlyToTheDriversThatAreChosen) {
  show("a", {{"site", "lab"}});
  show("b", {{"site", "roof"}});
  start("", "site == 'lab'");
  ASSERT_TRUE(reads(2));
  Mailbox to_a(*broker_, topic("a", "down")), to_b(*broker_, topic("b", "down"));
  device("a")->publish(message("one", "a"));
  ASSERT_TRUE(to_a.wait_for(1));

  tell("a", {{"site", "roof"}});
  tell("b", {{"site", "lab"}});
  const auto b = device("b");
  ASSERT_TRUE(eventually([&] {
    b->publish(message("two", "b"));
    return !to_b.texts().empty();
  }));
  const auto a = device("a");
  ASSERT_TRUE(eventually([&] {
    a->publish(message("three", "a"));
    return metric("iotcloud_bolt_unknown_driver_total") > 0;
  }));
}

TEST_F(Where, DoesNotLetWhatIsForAnUnchosenDriverWait) {
  show("a", {{"site", "roof"}});
  start("", "site == 'lab'");
  ASSERT_TRUE(reads(1));
  const auto a = device("a");
  ASSERT_TRUE(eventually([&] {
    a->publish(message("x", "a"));
    return metric("iotcloud_bolt_unknown_driver_total") > 2;
  }));
  tell("a", {{"site", "lab"}});
  Mailbox to_a(*broker_, topic("a", "down"));
  EXPECT_TRUE(eventually([&] {
    a->publish(message("y", "a"));
    return !to_a.texts().empty();
  }));
}

TEST_F(Where, DropsAndCountsOnSharedChannelsWhatIsNotChosen) {
  show("a", {{"site", "lab"}}, true);
  show("b", {{"site", "roof"}}, true);
  start("site == 'lab'");
  ASSERT_TRUE(reads(1));
  Mailbox to_a(*broker_, topic("a", "down")), to_b(*broker_, topic("b", "down"));
  const auto shared = broker_->publisher({"", "g.d.up", false}, many());
  for (int i = 0; i < 10; ++i) {
    shared->publish(message(std::to_string(i), "b"));
    shared->publish(message(std::to_string(i), "a"));
  }
  ASSERT_TRUE(to_a.wait_for(10));
  EXPECT_EQ(metric("iotcloud_spout_unselected_total"), 10);
  EXPECT_TRUE(to_b.texts().empty());

  tell("b", {{"site", "lab"}});
  ASSERT_TRUE(eventually([&] {
    shared->publish(message("again", "b"));
    return !to_b.texts().empty();
  }));
}

TEST_F(Where, LetsTheFirstMessagesOfADriverWaitForItsRecordInOrder) {
  show("a", {{"site", "lab"}}, true);
  start("site == 'lab'");
  ASSERT_TRUE(reads(1));
  Mailbox to_a(*broker_, topic("a", "down")), to_new(*broker_, topic("new", "down"));
  const auto shared = broker_->publisher({"", "g.d.up", false}, many());
  for (const char* text : {"1", "2", "3"}) shared->publish(message(text, "new"));
  shared->publish(message("other", "a"));
  ASSERT_TRUE(to_a.wait_for(1));  // whom the registry knows does not wait
  EXPECT_TRUE(to_new.texts().empty());
  show("new", {{"site", "lab"}}, true);
  ASSERT_TRUE(to_new.wait_for(3));
  EXPECT_THAT(to_new.texts(), ElementsAre("1", "2", "3"));
  EXPECT_EQ(metric("iotcloud_spout_unselected_total"), 0);
}

TEST_F(Where, RefusesAndCountsWhatComesFromADriverThatTheRegistryNeverTellsOf) {
  show("a", {{"site", "lab"}}, true);
  start("site == 'lab'");
  ASSERT_TRUE(reads(1));
  const auto shared = broker_->publisher({"", "g.d.up", false}, many());
  shared->publish(message("1", "nobody"));
  shared->publish(message("2", "nobody"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_untrue_senders_total") == 2; }));
  EXPECT_EQ(metric("iotcloud_spout_unselected_total"), 0);
}

TEST_F(Where, SaysInTheFileWhereAnExpressionIsWrong) {
  try {
    static_cast<void>(TopologyDefinition::parse(yaml("site == lab and battery > 20"), "t.yaml"));
    ADD_FAILURE() << "taken";
  } catch (const config::ConfigError& error) {
    EXPECT_STREQ(error.what(),
                 "t.yaml:7:20: spouts.in.where: expected a number, a text in quotes, true or false, but there is "
                 "\"lab\"; write \"lab\" for a text\n"
                 "  site == lab and battery > 20\n"
                 "          ^");
  }
}

}  // namespace
}  // namespace iotcloud::topology
