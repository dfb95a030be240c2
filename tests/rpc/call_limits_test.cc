// One who asks without end waits, and others do not.
#include <atomic>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/rpc/call_limits.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::rpc {
namespace {

using std::chrono::milliseconds;

/// Stands still until a test moves it.
struct LimitsClock final : config::Clock {
  Instant now() const override { return time; }
  std::int64_t wall_ms() const override { return 0; }
  Instant time = Instant() + std::chrono::hours(1);
};

TEST(CallLimits, AFloodOfOneIdentityIsRefusedAndOthersAreAnswered) {
  LimitsClock clock;
  CallLimits limits({.at_once = 1'000, .per_second = 10, .longest_wait = milliseconds(0)}, clock);
  int taken = 0;
  for (int i = 0; i < 100; ++i) taken += limits.enter("vera") ? 1 : 0;
  EXPECT_EQ(taken, 20);
  EXPECT_TRUE(limits.enter("otto"));
  clock.time += milliseconds(200);
  taken = 0;
  for (int i = 0; i < 100; ++i) taken += limits.enter("vera") ? 1 : 0;
  EXPECT_EQ(taken, 2);
}

TEST(CallLimits, SoManyCallsRunAtOnceAndTheNextWaitsForOneToEnd) {
  CallLimits limits({.at_once = 2, .per_second = 1e6, .longest_wait = tests::patience});
  auto first = limits.enter("vera");
  const auto second = limits.enter("vera");
  std::atomic<bool> entered{false};
  std::jthread third([&] {
    const auto ticket = limits.enter("vera");
    entered = ticket != nullptr;
  });
  EXPECT_TRUE(limits.enter("otto"));
  EXPECT_FALSE(entered);
  first.reset();
  EXPECT_TRUE(tests::eventually([&] { return entered.load(); }));
}

TEST(CallLimits, OneWhoseTurnDoesNotComeInTimeIsRefused) {
  CallLimits limits({.at_once = 1, .per_second = 1e6, .longest_wait = milliseconds(1)});
  const auto first = limits.enter("vera");
  EXPECT_FALSE(limits.enter("vera"));
}

TEST(CallLimits, WhoHasNotCalledForLongIsForgottenAndWhoHasCalledTooOftenIsNot) {
  LimitsClock clock;
  CallLimits limits({.at_once = 1'000, .per_second = 10, .longest_wait = milliseconds(0)}, clock);
  const auto running = limits.enter("otto");
  for (int i = 0; i < 10'000; ++i) {
    EXPECT_TRUE(limits.enter(std::to_string(i)));
    clock.time += std::chrono::seconds(1);
  }
  EXPECT_LT(limits.remembered(), 3'000u);
  while (limits.enter("vera")) {
  }
  for (int i = 0; i < 10'000; ++i) EXPECT_TRUE(limits.enter(std::to_string(i)));
  EXPECT_FALSE(limits.enter("vera"));
}

}  // namespace
}  // namespace iotcloud::rpc
