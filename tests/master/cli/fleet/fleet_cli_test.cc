// diff, apply, drain and undrain as a person uses them.
#include <algorithm>
#include <cstdio>
#include <fstream>

#include <gmock/gmock.h>
#include <unistd.h>

#include <iotcloud/tests/master/cli/cli_fixture.h>

namespace iotcloud::master::test {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

class CliFleet : public Cli {
 protected:
  ~CliFleet() override { std::remove(file.c_str()); }

  /// \param deployments YAML, one line for each.
  void write(const std::string& deployments) const {
    std::ofstream(file) << "fleet: lab\ndeployments:" << (deployments.empty() ? " {}" : "") << "\n" << deployments;
  }
  Finished apply(std::vector<std::string> more = {}) const { return fleet("apply", std::move(more)); }
  Finished diff(std::vector<std::string> more = {}) const { return fleet("diff", std::move(more)); }
  Finished fleet(const std::string& verb, std::vector<std::string> more) const {
    more.insert(more.begin(), {verb, "-f", file});
    return run(more);
  }
  /// "deploy lab1 meter/1" of a diff or an apply that is to end so.
  std::vector<std::string> changes(const Finished& done, int status) const {
    EXPECT_EQ(done.status, status) << done.out << done.err;
    std::vector<std::string> words;
    const auto answer = json::parse(done.out);
    for (const auto& change : answer["changes"])
      words.push_back(change["change"].get<std::string>() + " " + change["gateway"].get<std::string>() + " " +
                      change["name"].get<std::string>() + "/" + std::to_string(change["index"].get<int>()));
    return words;
  }
  const std::string file = testing::TempDir() + "iotcloud-fleet-" + std::to_string(getpid()) + ".yaml";
  FakeGateway lab1{url, "lab1"};
  FakeGateway lab2{url, "lab2"};
};

TEST_F(CliFleet, AnUpdateAndAnApplySayWhatTheyWaitFor) {
  ASSERT_EQ(run({"deploy", "turtle.so", "--gateway", "lab1", "--name", "slow"}).status, 0);
  lab1.behave([](const discovery::OrderRecord&) -> std::optional<FakeGateway::Report> {
    return std::pair(discovery::DriverState::starting, "its device does not answer");
  });
  const std::string waits = " on lab1 is starting: its device does not answer";
  EXPECT_THAT(run({"update", "--name", "slow", "--property", "rate=2", "--wait", "5"}).err, HasSubstr(waits));
  write("  fresh: {plugin: meter.so, gateways: [lab1]}\n");
  const auto applied = apply({"--wait", "5"});
  EXPECT_EQ(applied.status, 1);
  EXPECT_THAT(applied.err, HasSubstr(waits));
  EXPECT_EQ(applied.err.find("waits"), applied.err.rfind("waits")) << "not of instances that it does not change";
}

TEST_F(CliFleet, ApplyDeploysAndASecondTimeChangesNothing) {
  write(
      "  meter: {plugin: meter.so, gateways: all, count: 2, channels: {data: {priority: 5}}, metadata: {site: lab}}\n"
      "  spare: {plugin: meter.so, gateways: [lab2], state: inactive}\n");
  const Words all{"deploy lab1 meter/1", "deploy lab1 meter/2", "deploy lab2 meter/1", "deploy lab2 meter/2",
                  "deploy lab2 spare/1"};
  EXPECT_EQ(changes(diff({"-o", "json"}), 4), all);
  EXPECT_EQ(changes(apply({"--dry-run", "-o", "json"}), 4), all);
  EXPECT_THAT(lab1.orders(), SizeIs(0)) << "both only say what would be done";
  EXPECT_EQ(changes(apply({"-o", "json"}), 0), all);
  EXPECT_EQ(lab1.orders().at(0).properties.at("channel.data.priority"), "5");
  EXPECT_THAT(run_json({"drivers", "--name", "meter"}), SizeIs(4));
  EXPECT_EQ(run_json({"drivers", "--name", "spare"})[0]["state"], "inactive");

  const int seen = lab1.orders_seen() + lab2.orders_seen();
  const auto again = apply();
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_THAT(again.out, HasSubstr("nothing to do: 5 instances as the manifest says"));
  EXPECT_EQ(diff().status, 0);
  EXPECT_EQ(lab1.orders_seen() + lab2.orders_seen(), seen);
}

TEST_F(CliFleet, ChangesOnlyWhatDiffersAndTakesAwayOnlyWhatItDeployed) {
  ASSERT_EQ(run({"deploy", "turtle.so", "--name", "robot", "--gateway", "lab1"}).status, 0);
  write(
      "  a: {plugin: meter.so, gateways: [lab1], properties: {rate: 5}, metadata: {site: lab, note: x}}\n"
      "  b: {plugin: meter.so, gateways: [lab1]}\n"
      "  c: {plugin: meter.so, gateways: [lab1]}\n"
      "  d: {plugin: meter.so, gateways: [lab1], count: 2}\n");
  ASSERT_EQ(apply().status, 0);
  const auto ids_before = run_json({"drivers", "--name", "a"})[0]["instance"];
  write(
      "  a: {plugin: meter.so, gateways: [lab1], properties: {rate: 9}, metadata: {site: roof}}\n"
      "  b: {plugin: turtle.so, gateways: [lab1]}\n"
      "  c: {plugin: meter.so, gateways: [lab1], state: inactive}\n"
      "  d: {plugin: meter.so, gateways: [lab1], count: 1}\n");
  EXPECT_THAT(diff().out, AllOf(HasSubstr("rate: 5 -> 9"), HasSubstr("note: x -> -; site: lab -> roof"),
                                HasSubstr("plugin: meter.so -> turtle.so")));
  EXPECT_EQ(changes(apply({"--settle", "0", "-o", "json"}), 0),
            (Words{"undeploy lab1 d/2", "stop lab1 c/1", "update lab1 b/1", "change lab1 a/1", "describe lab1 a/1"}));
  EXPECT_EQ(diff().status, 0);
  const auto a = run_json({"drivers", "--name", "a"})[0];
  EXPECT_EQ(a["instance"], ids_before);
  EXPECT_EQ(a["metadata"], (json{{"site", "roof"}}));
  const auto b = run_json({"drivers", "--name", "b"})[0];
  EXPECT_EQ(b["plugin"]["file"], "turtle.so");
  EXPECT_EQ(b["driver"], "meter") << "its name is part of its topics";
  EXPECT_EQ(run_json({"drivers", "--name", "c"})[0]["state"], "inactive");

  write("");
  const auto kept = apply({"--no-prune"});
  EXPECT_EQ(kept.status, 0);
  EXPECT_THAT(kept.out, HasSubstr("kept, though the manifest does not name them any more: 4 instances"));
  EXPECT_THAT(run_json({"drivers"}), SizeIs(5));
  EXPECT_EQ(apply().status, 0);
  const auto left = run_json({"drivers"});
  ASSERT_THAT(left, SizeIs(1)) << "a person deployed it";
  EXPECT_EQ(left[0]["name"], "robot");
}

TEST_F(CliFleet, AnotherPluginComesToOneGatewayAfterTheOtherAndAllGoBackWhenOneDoesNotComeUp) {
  const auto ordered = [](const FakeGateway& gateway) {
    Words plugins;
    for (const auto& order : gateway.orders()) plugins.push_back(order.plugin + " " + order.metadata.at("site"));
    return plugins;
  };
  write(
      "  meter: {plugin: meter.so, gateways: all, metadata: {site: lab}}\n  else: {plugin: e.so, gateways: [lab2]}\n");
  ASSERT_EQ(apply().status, 0);
  lab2.behave([](const discovery::OrderRecord& order) {
    return order.plugin == "meter-2.so" ? FakeGateway::fail("it needs another SDK")(order) : FakeGateway::obey(order);
  });
  write(
      "  meter: {plugin: meter-2.so, gateways: all, count: 2, metadata: {site: roof}}\n"
      "  else: {plugin: e.so, gateways: [lab2], count: 2}\n");
  const auto failed = apply({"--settle", "0", "-o", "json"});
  EXPECT_EQ(changes(failed, 1),
            (Words{"update lab1 meter/1", "describe lab1 meter/1", "deploy lab1 meter/2", "update lab2 meter/1",
                   "describe lab2 meter/1", "deploy lab2 else/2", "deploy lab2 meter/2"}));
  std::map<std::string, std::string> outcomes;
  const auto answer = json::parse(failed.out);
  for (const auto& change : answer["changes"])
    outcomes[change["change"].get<std::string>() + " " + change["gateway"].get<std::string>() + " " +
             change["name"].get<std::string>()] =
        change["outcome"].get<std::string>() + " " + change["reason"].get<std::string>();
  EXPECT_THAT(outcomes["update lab1 meter"], AllOf(HasSubstr("failed back on meter.so"), HasSubstr("another SDK")));
  EXPECT_THAT(outcomes["update lab2 meter"], AllOf(HasSubstr("failed back on meter.so"), HasSubstr("another SDK")));
  EXPECT_THAT(outcomes["describe lab1 meter"], HasSubstr("failed not begun, for its deployment was not updated: "));
  EXPECT_THAT(outcomes["deploy lab2 meter"], HasSubstr("failed not begun"));
  EXPECT_THAT(outcomes["deploy lab2 else"], HasSubstr("done")) << "another deployment's is";
  EXPECT_EQ(ordered(lab1), Words{"meter.so lab"});
  EXPECT_THAT(run_json({"drivers", "--name", "meter", "--state", "active"}), SizeIs(2));

  lab2.behave(FakeGateway::obey);
  const auto seen = lab1.orders_seen();
  EXPECT_EQ(apply({"--settle", "0"}).status, 0);
  EXPECT_EQ(ordered(lab1), (Words{"meter-2.so roof", "meter-2.so roof"}));
  EXPECT_GT(lab1.orders_seen(), seen);
  EXPECT_EQ(diff().status, 0);
}

TEST_F(CliFleet, WhatAPersonDeployedIsTakenOverOnlyWhenThatIsSaid) {
  ASSERT_EQ(run({"deploy", "meter.so", "--name", "meter", "--gateway", "lab1"}).status, 0);
  write("  meter: {plugin: meter.so, gateways: [lab1], state: inactive}\n");
  const auto refused = apply();
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("meter on lab1"), HasSubstr("--adopt")));
  EXPECT_EQ(diff().status, 1);
  EXPECT_EQ(run_json({"drivers"})[0]["state"], "active");
  EXPECT_EQ(apply({"--adopt"}).status, 0);
  EXPECT_EQ(run_json({"drivers"})[0]["state"], "inactive");
  EXPECT_EQ(apply().status, 0);
}

TEST_F(CliFleet, PartialFailuresAreListedByGatewayAndTheOthersAreDone) {
  lab1.behave(FakeGateway::fail("no such plugin"));
  write("  meter: {plugin: meter.so, gateways: [lab1, lab3, lab2], count: 2}\n");
  const auto done = apply();
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("failed"), HasSubstr("no such plugin"), HasSubstr("done")));
  EXPECT_THAT(done.err, AllOf(HasSubstr("lab1: 2 of 2 changes not done; the first: failed: no such plugin"),
                              HasSubstr("meter on lab3: there is no such gateway; there are lab1, lab2"),
                              Not(HasSubstr("lab2: "))));
  EXPECT_THAT(run_json({"drivers", "--state", "active"}), SizeIs(2));

  lab1.behave(FakeGateway::obey);  // somebody has put the plugin there
  write("  meter: {plugin: meter.so, gateways: [lab1, lab2], count: 2}\n");
  EXPECT_EQ(changes(apply({"-o", "json"}), 0), (Words{"start lab1 meter/1", "start lab1 meter/2"}));
  EXPECT_EQ(diff().status, 0);
}

TEST_F(CliFleet, AGatewayThatDoesNotAnswerDelaysItsOwnChangesOnce) {
  lab1.behave(FakeGateway::say_nothing());
  write("  a: {plugin: meter.so, gateways: all}\n  b: {plugin: meter.so, gateways: all}\n");
  const auto done = apply({"--wait", "0.3"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("lab1: 2 of 2 changes not done; the first: unknown: "));
  EXPECT_THAT(done.out, HasSubstr("0.001 s")) << "the second was ordered and not waited for";
  EXPECT_THAT(run_json({"drivers", "--gateway", "lab2", "--state", "active"}), SizeIs(2));
  EXPECT_TRUE(lab1.wait_for_orders(2));
}

TEST_F(CliFleet, AManifestThatCannotBeUsedIsWrongUsageAndNoMasterIsAsked) {
  write("  meter: {plugin: meter.so, gateways: all, cuont: 2}\n");
  const auto done = run({"--master", "127.0.0.1:1", "apply", "-f", file});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, AllOf(HasSubstr(file + ":3:"), HasSubstr("deployments.meter.cuont"), HasSubstr("\"count\"")));
  write("");
  EXPECT_EQ(run({"--master", "127.0.0.1:1", "apply", "-f", file}).status, 3);
}

TEST_F(CliFleet, DrainIsShownPassedByAndUndone) {
  write("  meter: {plugin: meter.so, gateways: all}\n");
  ASSERT_EQ(apply().status, 0);
  EXPECT_THAT(run({"drain", "lab1"}).out, AllOf(HasSubstr("lab1"), HasSubstr("done")));
  EXPECT_THAT(run({"gateways"}).out, HasSubstr("ready, draining"));
  EXPECT_EQ(run_json({"gateways"})[0]["draining"], true);
  EXPECT_EQ(diff().status, 0) << "what is drained is wanted as before";
  EXPECT_THAT(run({"deploy", "turtle.so", "--gateway", "lab1"}).err, HasSubstr("iotcloud undrain lab1"));
  write("  meter: {plugin: meter.so, gateways: all, count: 2}\n");
  EXPECT_THAT(apply().out, HasSubstr("passed by: lab1 is draining"));
  EXPECT_EQ(run({"drain", "lab1", "--undo"}).status, 0);
  EXPECT_THAT(run({"undrain", "lab1"}).out, HasSubstr("no instance had to change"));
  EXPECT_EQ(changes(apply({"-o", "json"}), 0), (Words{"deploy lab1 meter/2"}));
  EXPECT_THAT(run_json({"drivers", "--state", "active"}), SizeIs(4));
  EXPECT_EQ(run({"drain", "lab7"}).status, 1);
}

TEST_F(CliFleet, WhatIsOrderedOfALostGatewayIsCounted) {
  { FakeGateway gone(url, "lab3"); }
  ASSERT_TRUE(test::eventually([&] { return run_json({"status"})["gateways"]["lost"] == 1; }));
  write("  meter: {plugin: meter.so, gateways: [lab1, lab3], count: 2}\n");
  apply();
  const auto again = diff();
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_THAT(again.out, AllOf(HasSubstr("nothing to do: 4 instances as the manifest says"),
                               HasSubstr("only ordered: 2 instances of lost gateways")));
  EXPECT_EQ(json::parse(diff({"-o", "json"}).out)["ordered"], 2);
}

TEST_F(CliFleet, LargeChangesAreGivenInSeveralOrders) {
  write("  meter: {plugin: meter.so, gateways: [lab1], count: 450}\n");
  EXPECT_THAT(changes(apply({"-o", "json"}), 0), SizeIs(450));
  EXPECT_EQ(diff().status, 0);
  write("  meter: {plugin: meter.so, gateways: [lab1], count: 1}\n");
  EXPECT_THAT(changes(apply({"-o", "json"}), 0), SizeIs(449));
}

}  // namespace
}  // namespace iotcloud::master::test
