// Whom a gateway takes for the owner of its place in the registry.
#include <gmock/gmock.h>

#include <iotcloud/gateway/membership.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::gateway {
namespace {

using Holder = Membership::Holder;

class MembershipTest : public testing::Test {
 protected:
  explicit MembershipTest(std::string state_id = "this folder")
      : registry_(discovery::make_registry({.url = "embedded://membership-test"})),
        membership_(*registry_, paths_, options(std::move(state_id))) {}

  static Membership::Options options(std::string state_id) {
    Membership::Options options;
    options.record.id = "gw"_gateway;
    options.state_id = std::move(state_id);
    options.clock = &config::system_clock();
    return options;
  }
  static discovery::Node mark(const std::string& state, const std::string& run) {
    discovery::Node node;
    node.data = encode(discovery::GatewayLife{"lab1", 12905, 7, state, run});
    return node;
  }

  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  Membership membership_;
};

class MembershipWithoutAFolder : public MembershipTest {
 protected:
  MembershipWithoutAFolder() : MembershipTest("") {}
};

TEST_F(MembershipTest, ItsOwnNodeIsItsOwn) {
  ASSERT_EQ(membership_.join(), Membership::Result::joined);
  EXPECT_EQ(membership_.holder(registry_->get(paths_.gateway_alive("gw"_gateway))), Holder::self);
}

TEST_F(MembershipTest, ANodeThatIsGoneIsNobodys) {
  EXPECT_EQ(membership_.holder(std::nullopt), Holder::nobody);
}

TEST_F(MembershipTest, TheNodeOfAnEarlierRunIsNobodysBecauseThatRunIsDead) {
  EXPECT_EQ(membership_.holder(mark("this folder", "an earlier run")), Holder::nobody);
}

TEST_F(MembershipTest, TheNodeOfAGatewayWithAnotherFolderIsThatGateways) {
  EXPECT_EQ(membership_.holder(mark("its folder", "its run")), Holder::another);
  EXPECT_EQ(membership_.holder_address(), "lab1:12905");
  EXPECT_EQ(membership_.holder(mark("", "its run")), Holder::another);
}

TEST_F(MembershipWithoutAFolder, NoOtherNodeIsThatOfAnEarlierRun) {
  EXPECT_EQ(membership_.holder(mark("", "an earlier run")), Holder::another);
}

}  // namespace
}  // namespace iotcloud::gateway
