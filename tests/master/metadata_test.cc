#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;
using testing::Pair;
using testing::SizeIs;
using testing::UnorderedElementsAre;

class MasterMetadata : public testing::Test {
 protected:
  MasterMetadata() { EXPECT_TRUE(master.leads()); }
  std::string deploy(const std::string& gateway, MetadataChanges metadata = {}) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.gateways = {discovery::GatewayId(gateway)};
    request.metadata = std::move(metadata);
    return master->deploy(request).outcomes.at(0).instance;
  }
  static InstanceSelection only(const std::string& id, WaitLimit wait = std::nullopt) {
    return {{discovery::InstanceId(id)}, {}, wait};
  }

  const std::string url = test::fresh_registry_url();
  TestMaster master{url};
};

TEST_F(MasterMetadata, IsDoneWhenTheRecordShowsTheChange) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1", {{"site", "lab"}, {"note", "old"}, {"kept", "1"}});
  const auto result = master->update_metadata(only(id), {{"site", "roof"}, {"note", ""}, {"battery", "5"}});
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_THAT(master->drivers().at(0).metadata,
              UnorderedElementsAre(Pair("site", "roof"), Pair("battery", "5"), Pair("kept", "1")));
  EXPECT_EQ(gateway.orders().at(0).properties.size(), 0U);
  EXPECT_TRUE(gateway.orders().at(0).active);
}

TEST_F(MasterMetadata, IsDoneOfAnInstanceThatIsNotActive) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1");
  ASSERT_TRUE(master->stop(only(id)).all_done());
  EXPECT_TRUE(master->update_metadata(only(id), {{"site", "roof"}}).all_done());
  EXPECT_EQ(master->drivers().at(0).state, DriverState::inactive);
}

TEST_F(MasterMetadata, IsUnknownWhileTheRecordDoesNotShowIt) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1", {{"site", "lab"}});
  gateway.behave(FakeGateway::say_nothing());
  const auto result = master->update_metadata(only(id, std::chrono::milliseconds(50)), {{"site", "roof"}});
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::unknown);
}

TEST_F(MasterMetadata, WaitsForAGatewayThatIsLost) {
  std::string id;
  {
    FakeGateway gateway(url, "lab1");
    id = deploy("lab1");
  }
  ASSERT_TRUE(test::eventually([&] { return !master->gateways().at(0).alive; }));
  const auto result = master->update_metadata(only(id), {{"site", "roof"}});
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::pending);
  FakeGateway again(url, "lab1");
  EXPECT_TRUE(test::eventually([&] { return master->drivers().at(0).metadata.contains("site"); }));
}

TEST_F(MasterMetadata, RefusesNothingAndKeysThatAreNone) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1");
  EXPECT_EQ(master->update_metadata(only(id), {}).refusal, OrderRefusal::bad_request);
  EXPECT_EQ(master->update_metadata(only(id), {{"", "1"}}).refusal, OrderRefusal::bad_request);
  EXPECT_EQ(master->update_metadata(only("nobody"), {{"a", "1"}}).refusal, OrderRefusal::unknown_instance);
  const auto huge = master->update_metadata(only(id), {{"a", std::string(600'000, 'x')}});
  ASSERT_THAT(huge.outcomes, SizeIs(1));
  EXPECT_EQ(huge.outcomes[0].outcome, OrderOutcome::failed);
  EXPECT_THAT(huge.outcomes[0].reason, HasSubstr("more than 524288"));
}

}  // namespace
}  // namespace iotcloud::master
