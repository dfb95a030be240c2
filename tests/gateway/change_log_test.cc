#include <gmock/gmock.h>

#include <iotcloud/gateway/change_log.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

std::vector<DriverState> states(const std::vector<StateChange>& changes) {
  std::vector<DriverState> states;
  for (const auto& change : changes) states.push_back(change.state);
  return states;
}

TEST(ChangeLog, KeepsTheLatestOfAllAndTellsThemByInstance) {
  ChangeLog log(3);
  for (const auto* id : {"a", "b", "a", "b"}) log.add({id, "d", DriverState::active, "", 0});
  EXPECT_EQ(log.of("").size(), 3u);
  EXPECT_EQ(log.of("a").size(), 1u);
  EXPECT_EQ(log.of("b").size(), 2u);
  EXPECT_THAT(log.of("c"), IsEmpty());
}

class DriverHistory : public GatewayFixture {};

TEST_F(DriverHistory, HasEveryStateOfAnInstanceWithItsTimeItsEndToo) {
  start_gateway();
  give(order("a", {{"channels", "none"}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  auto paused = order("a", {{"channels", "none"}});
  paused.active = false;
  give(paused);
  ASSERT_TRUE(comes_to("a", DriverState::inactive));
  take_back("a");
  ASSERT_TRUE(eventually([&] { return states(gateway_->changes("a")).back() == DriverState::undeployed; }));
  const auto changes = gateway_->changes("a");
  EXPECT_THAT(states(changes),
              ElementsAre(DriverState::deployed, DriverState::starting, DriverState::active, DriverState::stopping,
                          DriverState::inactive, DriverState::stopping, DriverState::undeployed));
  for (std::size_t i = 0; i < changes.size(); ++i) {
    EXPECT_GT(changes[i].time_ms, 0);
    EXPECT_GE(changes[i].time_ms, changes[i == 0 ? 0 : i - 1].time_ms);
  }
  EXPECT_EQ(changes.back().reason, "as ordered");
}

TEST_F(DriverHistory, SaysWhyAnInstanceFailed) {
  start_gateway();
  give(order("a", {{"channels", "none"}, {"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(gateway_->changes("a").back().reason, ::testing::HasSubstr("told to throw in open"));
}

}  // namespace
}  // namespace iotcloud::gateway
