// Rules that provision, in a gateway with driver hosts inside this process.
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/provisioning/provisioning_fixture.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using discovery::OrderRecord;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

TEST_F(ProvisioningGatewayTest, makes_instances_of_what_a_finder_finds_and_says_so) {
  start();
  ASSERT_TRUE(comes_to(id("eye"), DriverState::active, "finder"));
  EXPECT_EQ(record(id("eye"), "finder")->made_by, "finder eye");
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  const auto made = *record(id("p-7"));
  EXPECT_EQ(made.made_by, "rule probes");
  EXPECT_EQ(made.deployment, "p-7");
  EXPECT_EQ(made.index, 1);
  EXPECT_EQ(made.metadata.at("of"), "7");
  ASSERT_TRUE(comes_to_say(id("p-7"), "id", "7")) << "its property says";
  ASSERT_TRUE(comes_to_say(id("eye"), "made", "1", "finder"));
  TestFinder::with([](auto& context) { context.report_gone("7"); });
  EXPECT_TRUE(gone("p-7"));
}

TEST_F(ProvisioningGatewayTest, follows_what_people_say_about_an_instance_of_a_rule) {
  start();
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  give(word("p-7", false));
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::inactive));
  EXPECT_EQ(record(id("p-7"))->made_by, "rule probes");
  give(word("p-7", false, true));
  ASSERT_TRUE(gone("p-7"));
  give(word("p-7", true));
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  take_back(id("p-7"));
  TestFinder::find("8");
  ASSERT_TRUE(comes_to(id("p-8"), DriverState::active));
  EXPECT_TRUE(comes_to(id("p-7"), DriverState::active));
}

TEST_F(ProvisioningGatewayTest, gives_a_name_to_the_master_that_orders_it_and_takes_it_back) {
  start();
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  OrderRecord ordered = order(id("p-7"), {{"says", "who=master"}});
  ordered.name = "p-7";
  ordered.index = 1;
  give(ordered);
  ASSERT_TRUE(eventually([&] {
    auto now = record(id("p-7"));
    return now && now->made_by.empty() && now->metadata["who"] == "master" && now->state == DriverState::active;
  }));
  take_back(id("p-7"));
  ASSERT_TRUE(eventually([&] {
    auto now = record(id("p-7"));
    return now && now->made_by == "rule probes" && now->metadata["id"] == "7" && now->state == DriverState::active;
  }));
}

TEST_F(ProvisioningGatewayTest, keeps_what_it_made_over_a_restart_though_nothing_is_announced_again) {
  start("1h");
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  ASSERT_TRUE(
      eventually([&] { return tests::read_file(folder_ / "provisioned.jsonl").find("\"7\"") != std::string::npos; }));
  give(word("p-8", false, true));
  gateway_.reset();
  EXPECT_EQ(record(id("p-7"))->state, DriverState::inactive);
  start("1h");
  EXPECT_TRUE(comes_to(id("p-7"), DriverState::active));
  TestFinder::find("8");
  TestFinder::find("9");
  ASSERT_TRUE(comes_to(id("p-9"), DriverState::active));
  EXPECT_FALSE(record(id("p-8"))) << "a person has said so while it was not there";
}

TEST_F(ProvisioningGatewayTest, makes_nothing_of_a_plugin_that_it_has_not) {
  auto given = options();
  given.provisioning = ProvisioningRules::parse(
      "finders: {eye: {plugin: finder.so}}\n"
      "rules: {none: {finder: eye, plugin: absent.so, name: 'p-{id}'}}\n",
      "rules.yaml");
  gateway_.emplace(std::move(given));
  gateway_->start();
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::failed, "absent"));
  EXPECT_THAT(record(id("p-7"), "absent")->reason, HasSubstr("absent.so"));
}

TEST_F(ProvisioningGatewayTest, is_not_frozen_by_a_registry_that_lost_what_only_rules_made) {
  start();
  TestFinder::find("7");
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::active));
  EXPECT_EQ(gateway_->trouble(), "");
  // A node without orders is that of a gateway that never had any.
  give(order("ordered"));
  ASSERT_TRUE(comes_to("ordered", DriverState::active));
  take_back("ordered");
  ASSERT_TRUE(eventually([&] { return !record("ordered"); }));
  EXPECT_TRUE(comes_to(id("p-7"), DriverState::active));
  EXPECT_EQ(gateway_->trouble(), "");
}

TEST_F(ProvisioningGatewayTest, holds_what_is_found_while_it_drains) {
  discovery::put(*registry_, paths_.gateway_draining("gw"_gateway), encode(discovery::DrainRecord{}));
  start();
  TestFinder::find("7");
  ASSERT_TRUE(comes_to_say(id("eye"), "found", "1", "finder"));
  EXPECT_FALSE(record(id("p-7")));
  registry_->remove(paths_.gateway_draining("gw"_gateway));
  EXPECT_TRUE(comes_to(id("p-7"), DriverState::active));
}

}  // namespace
}  // namespace iotcloud::gateway
