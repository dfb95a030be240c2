#include <gmock/gmock.h>

#include <iotcloud/master/cli/fleet/plan.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::master::cli {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::Pair;
using testing::SizeIs;
using testing::UnorderedElementsAre;

ManifestDeployment deployment(const std::string& name, std::vector<std::string> gateways, int count = 1) {
  ManifestDeployment deployment;
  deployment.name = name;
  deployment.plugin = "meter.so";
  deployment.all_gateways = gateways.empty();
  deployment.gateways = {gateways.begin(), gateways.end()};
  deployment.count = count;
  deployment.properties = {{"rate", "5"}};
  deployment.metadata = {{"site", "lab"}};
  return deployment;
}

/// As that deployment orders it.
Fleet::Instance instance(const ManifestDeployment& from, const std::string& gateway, int index,
                         const std::string& manager = "lab") {
  Fleet::Instance there{from,
                        discovery::GatewayId(gateway),
                        discovery::InstanceId(gateway + from.name + std::to_string(index)),
                        index,
                        "",
                        false,
                        {}};
  there.manager = manager;
  return there;
}

std::vector<std::string> words(const FleetPlan& plan) {
  std::vector<std::string> out;
  for (const auto& step : plan.steps)
    out.push_back(to_string(step.kind) + " " + step.gateway + " " + step.name + "/" + std::to_string(step.index));
  return out;
}

class FleetPlanning : public testing::Test {
 protected:
  FleetPlanning() {
    fleet.gateways = {{"lab1"_gateway, false, false}, {"lab2"_gateway, false, false}};
    manifest.fleet = "lab";
  }
  FleetPlan plan(const FleetPlanOptions& options = {}) const { return make_plan(manifest, fleet, options); }

  Manifest manifest;
  Fleet fleet;
};

TEST_F(FleetPlanning, WhatIsMissingIsDeployedAndOnlyThat) {
  manifest.deployments = {deployment("meter", {"lab1", "lab2"}, 2)};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 2)};
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("deploy lab1 meter/1", "deploy lab2 meter/1", "deploy lab2 meter/2"));
  EXPECT_EQ(made.same, 1U);
  EXPECT_THAT(made.problems, IsEmpty());
}

TEST_F(FleetPlanning, AFleetAsTheManifestSaysNeedsNothing) {
  manifest.deployments = {deployment("meter", {}, 3)};
  for (const char* gateway : {"lab1", "lab2"})
    for (int i = 1; i <= 3; ++i) fleet.instances.push_back(instance(manifest.deployments[0], gateway, i));
  const auto made = plan();
  EXPECT_THAT(made.steps, IsEmpty());
  EXPECT_EQ(made.same, 6U);
}

TEST_F(FleetPlanning, AllMeansEveryGatewayThatFollowsOrders) {
  fleet.gateways.push_back({"java"_gateway, false, true});
  manifest.deployments = {deployment("meter", {})};
  EXPECT_THAT(words(plan()), ElementsAre("deploy lab1 meter/1", "deploy lab2 meter/1"));
}

TEST_F(FleetPlanning, WhatTheManifestDeployedAndDoesNotNameAnyMoreGoesAndNothingElse) {
  auto old = deployment("old", {"lab1"});
  manifest.deployments = {deployment("meter", {"lab1"}, 1)};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1),
                     instance(manifest.deployments[0], "lab1", 2),  // there were two once
                     instance(manifest.deployments[0], "lab2", 1),  // it was there once
                     instance(old, "lab1", 1),                      // it was named once
                     instance(old, "lab2", 1, ""),                  // a person's
                     instance(old, "lab2", 2, "other")};            // another manifest's
  discovery::Deployment nameless;
  nameless.plugin = "meter.so";
  fleet.instances.push_back({nameless, "lab1"_gateway, "nameless"_instance, 0, "", false, {}});
  EXPECT_THAT(words(plan()), ElementsAre("undeploy lab1 meter/2", "undeploy lab1 old/1", "undeploy lab2 meter/1"));
  const auto kept = plan({.prune = false, .adopt = false});
  EXPECT_THAT(kept.steps, IsEmpty());
  EXPECT_THAT(kept.kept, SizeIs(3));
}

TEST_F(FleetPlanning, OtherPropertiesAreAChangeThatSaysWhatDiffers) {
  manifest.deployments = {deployment("meter", {"lab1"})};
  auto there = instance(manifest.deployments[0], "lab1", 1);
  there.properties = {{"rate", "4"}, {"gone", "1"}};
  manifest.deployments[0].properties["new"] = "";
  fleet.instances = {there};
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("change lab1 meter/1"));
  EXPECT_THAT(made.steps[0].what, ElementsAre("gone: 1 -> -", "new: - -> \"\"", "rate: 4 -> 5"));
  EXPECT_EQ(made.steps[0].instance, there.instance);
}

TEST_F(FleetPlanning, ASecretThatIsHiddenIsTakenForWhatIsWanted) {
  manifest.deployments = {deployment("meter", {"lab1"})};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1)};
  fleet.instances[0].hidden = {"password"};
  manifest.deployments[0].properties["password"] = "whichever";
  auto made = plan();
  EXPECT_THAT(words(made), IsEmpty());
  EXPECT_THAT(made.not_compared, ElementsAre("password"));
  manifest.deployments[0].properties["rate"] = "9";
  EXPECT_THAT(plan().steps.at(0).what, ElementsAre("rate: 5 -> 9"));
  manifest.deployments[0].properties = {{"rate", "5"}};
  EXPECT_THAT(plan().steps.at(0).what, ElementsAre("password: *** -> -"));
}

TEST_F(FleetPlanning, SecretsAreNotShown) {
  manifest.deployments = {deployment("meter", {"lab1"})};
  auto there = instance(manifest.deployments[0], "lab1", 1);
  there.properties["api_Token"] = "old secret";
  manifest.deployments[0].properties["api_Token"] = "new secret";
  fleet.instances = {there};
  EXPECT_THAT(plan().steps.at(0).what, ElementsAre("api_Token: *** -> ***"));
}

TEST_F(FleetPlanning, OtherMetadataIsChangedInPlaceByKeys) {
  manifest.deployments = {deployment("meter", {"lab1"})};
  auto there = instance(manifest.deployments[0], "lab1", 1);
  there.metadata = {{"site", "roof"}, {"note", "x"}};
  fleet.instances = {there};
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("describe lab1 meter/1"));
  EXPECT_THAT(made.steps[0].metadata, UnorderedElementsAre(Pair("site", "lab"), Pair("note", "")));
}

TEST_F(FleetPlanning, AnotherStateIsStartedOrStopped) {
  manifest.deployments = {deployment("a", {"lab1"}), deployment("b", {"lab1"})};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1), instance(manifest.deployments[1], "lab1", 1)};
  fleet.instances[0].active = false;
  manifest.deployments[1].active = false;
  EXPECT_THAT(words(plan()), ElementsAre("stop lab1 b/1", "start lab1 a/1"));
}

TEST_F(FleetPlanning, AnInstanceThatFailedIsStartedAgainUnlessItIsMadeAnewOrMayNotRun) {
  manifest.deployments = {deployment("a", {"lab1"}), deployment("b", {"lab1"}), deployment("c", {"lab2"})};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1), instance(manifest.deployments[1], "lab1", 1),
                     instance(manifest.deployments[2], "lab2", 1)};
  for (auto& instance : fleet.instances) instance.failure = "no device";
  manifest.deployments[1].properties["rate"] = "7";
  fleet.gateways[1].draining = true;
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("change lab1 b/1", "start lab1 a/1"));
  EXPECT_THAT(made.steps[1].what, ElementsAre("it failed: no device"));
}

TEST_F(FleetPlanning, AnotherPluginIsAnUpdateAndAnotherDriverAReplacement) {
  manifest.deployments = {deployment("a", {"lab1"}), deployment("b", {"lab1"}), deployment("c", {"lab1"})};
  for (const auto& one : manifest.deployments) fleet.instances.push_back(instance(one, "lab1", 1));
  fleet.instances[0].plugin = "old.so";
  fleet.instances[0].active = false;
  manifest.deployments[1].driver = "thermometer"_driver;
  fleet.instances[2].plugin = "old.so";
  manifest.deployments[2].driver = "thermometer"_driver;
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("replace lab1 b/1", "replace lab1 c/1", "update lab1 a/1", "start lab1 a/1"));
  EXPECT_THAT(made.steps[0].what, ElementsAre("driver: the plugin's own -> thermometer"));
  EXPECT_THAT(made.steps[1].what, ElementsAre("plugin: old.so -> meter.so", "driver: the plugin's own -> thermometer"));
  EXPECT_THAT(made.steps[2].what, ElementsAre("plugin: old.so -> meter.so"));
}

TEST_F(FleetPlanning, ADriversNameThatNoManifestGaveStays) {
  manifest.deployments = {deployment("a", {"lab1"})};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1)};
  fleet.instances[0].driver = "meter"_driver;  // an update has written it down
  EXPECT_THAT(plan().steps, IsEmpty());
}

TEST_F(FleetPlanning, WhatElseDiffersComesBehindTheUpdateAndOneThatFailedIsNotStartedBesides) {
  manifest.deployments = {deployment("meter", {"lab1"}, 2)};
  for (int i = 1; i <= 2; ++i) {
    fleet.instances.push_back(instance(manifest.deployments[0], "lab1", i));
    fleet.instances.back().plugin = "old.so";
  }
  fleet.instances[0].properties = {{"rate", "4"}};
  fleet.instances[0].metadata = {{"site", "roof"}};
  fleet.instances[1].failure = "no device";
  EXPECT_THAT(words(plan()), ElementsAre("update lab1 meter/1", "update lab1 meter/2", "change lab1 meter/1",
                                         "describe lab1 meter/1"));
  EXPECT_EQ(plan().same, 0U);
}

TEST_F(FleetPlanning, ALostGatewayIsNotUpdatedAndTheOthersAre) {
  manifest.deployments = {deployment("meter", {})};
  fleet.gateways[0].lost = true;
  for (const auto* gateway : {"lab1", "lab2"}) {
    fleet.instances.push_back(instance(manifest.deployments[0], gateway, 1));
    fleet.instances.back().plugin = "old.so";
  }
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("update lab2 meter/1"));
  ASSERT_THAT(made.problems, SizeIs(1));
  EXPECT_EQ(made.problems[0].gateway, "lab1");
  EXPECT_THAT(made.problems[0].text, HasSubstr("the gateway is lost"));
}

TEST_F(FleetPlanning, OtherBytesUnderOneNameAreAnotherPlugin) {
  const std::string one(64, '1'), two(64, '2');
  manifest.deployments = {deployment("meter", {"lab1"}, 2)};
  manifest.deployments[0].sha256 = one;
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1), instance(manifest.deployments[0], "lab1", 2)};
  EXPECT_THAT(plan().steps, IsEmpty());
  fleet.instances[1].sha256 = "";
  EXPECT_THAT(words(plan()), ElementsAre("update lab1 meter/2"));
  EXPECT_THAT(plan().steps.at(0).what, ElementsAre("plugin: meter.so -> meter.so (111111111111)"));
  manifest.deployments[0].sha256 = two;
  EXPECT_THAT(plan().steps.at(0).what, ElementsAre("plugin: meter.so (111111111111) -> meter.so (222222222222)"));
}

TEST_F(FleetPlanning, WhatOthersDeployedUnderANameOfItsIsAProblemUntilItMayBeAdopted) {
  manifest.deployments = {deployment("meter", {"lab1"}, 2)};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1, ""),
                     instance(manifest.deployments[0], "lab1", 2, "other")};
  fleet.instances[0].active = false;
  const auto made = plan();
  EXPECT_THAT(made.steps, IsEmpty());
  ASSERT_THAT(made.problems, SizeIs(2));
  EXPECT_THAT(made.problems[0].text, AllOf(HasSubstr("meter/1"), HasSubstr("a person"), HasSubstr("--adopt")));
  EXPECT_THAT(made.problems[1].text, HasSubstr("\"other\""));
  const auto adopting = plan({.prune = true, .adopt = true});
  EXPECT_THAT(adopting.problems, IsEmpty());
  EXPECT_THAT(words(adopting), ElementsAre("adopt lab1 meter/1", "adopt lab1 meter/2", "start lab1 meter/1"));
}

TEST_F(FleetPlanning, AGatewayThatDrainsKeepsWhatItHasAndGetsNothingNew) {
  fleet.gateways[0].draining = true;
  manifest.deployments = {deployment("meter", {}, 2)};
  fleet.instances = {instance(manifest.deployments[0], "lab1", 1), instance(manifest.deployments[0], "lab2", 1),
                     instance(manifest.deployments[0], "lab2", 2)};
  fleet.instances[0].metadata["site"] = "roof";
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("describe lab1 meter/1"));
  EXPECT_THAT(made.passed_by, ElementsAre("lab1"));
  EXPECT_THAT(made.problems, IsEmpty());

  manifest.deployments[0].all_gateways = false;
  manifest.deployments[0].gateways = {"lab1"_gateway, "lab2"_gateway};
  const auto named = plan();
  ASSERT_THAT(named.problems, SizeIs(1));
  EXPECT_THAT(named.problems[0].text, HasSubstr("iotcloud undrain lab1"));
  manifest.deployments[0].plugin = "new.so";
  EXPECT_THAT(words(plan()), ElementsAre("update lab2 meter/1", "update lab2 meter/2"));
}

TEST_F(FleetPlanning, AGatewayThatCannotBeUsedIsAProblemAndTheOthersAreServed) {
  fleet.gateways.push_back({"java"_gateway, false, true});
  manifest.deployments = {deployment("meter", {"lab3", "java", "lab1"})};
  const auto made = plan();
  EXPECT_THAT(words(made), ElementsAre("deploy lab1 meter/1"));
  ASSERT_THAT(made.problems, SizeIs(2));
  EXPECT_THAT(made.problems[0].text, HasSubstr("there are lab1, lab2"));
  EXPECT_THAT(made.problems[1].text, HasSubstr("original system"));
}

TEST_F(FleetPlanning, OnAGatewayInstancesGoBeforeOthersCome) {
  manifest.deployments = {deployment("a", {}), deployment("b", {"lab1"})};
  fleet.instances = {instance(deployment("z", {}), "lab1", 1), instance(manifest.deployments[1], "lab1", 1),
                     instance(deployment("z", {}), "lab2", 1)};
  fleet.instances[1].properties.clear();
  EXPECT_THAT(words(plan()), ElementsAre("undeploy lab1 z/1", "change lab1 b/1", "deploy lab1 a/1", "undeploy lab2 z/1",
                                         "deploy lab2 a/1"));
}

}  // namespace
}  // namespace iotcloud::master::cli
