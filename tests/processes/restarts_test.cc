#include <gtest/gtest.h>

#include <iotcloud/processes/restarts.h>

namespace iotcloud::processes {
namespace {

using namespace std::chrono_literals;

constexpr RestartPolicy policy{.first = 100ms, .longest = 300ms, .healthy_after = 10s, .give_up_after = 5};

TEST(Restarts, DoubleThePauseUpToTheLongestAndGiveUpInTheEnd) {
  Restarts restarts;
  Restarts::Instant now{};
  restarts.started(now);
  for (const auto pause : {100ms, 200ms, 300ms, 300ms}) EXPECT_EQ(restarts.failed(now, policy), pause);
  EXPECT_EQ(restarts.failed(now, policy), std::nullopt);
  EXPECT_EQ(restarts.failures(), 5);
}

TEST(Restarts, BeginAnewAfterItHasRunForLong) {
  Restarts restarts;
  Restarts::Instant now{};
  restarts.started(now);
  EXPECT_EQ(restarts.failed(now, policy), 100ms);
  EXPECT_EQ(restarts.failed(now, policy), 200ms);
  restarts.started(now);
  EXPECT_EQ(restarts.failed(now + 10s, policy), 100ms);
  EXPECT_EQ(restarts.failures(), 1);
}

TEST(Restarts, NeverGiveUpWithoutALimit) {
  auto patient = policy;
  patient.give_up_after = 0;
  Restarts restarts;
  for (int failure = 0; failure < 100; ++failure) EXPECT_TRUE(restarts.failed({}, patient));
}

}  // namespace
}  // namespace iotcloud::processes
