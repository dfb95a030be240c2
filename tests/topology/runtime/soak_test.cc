#include <gtest/gtest.h>

#include <iotcloud/bench/runtime/soak_run.h>

namespace iotcloud::bench {
namespace {

/// Runs for two seconds of disturbance. The long run is `./dev bench soak`.
void soak(double rate, std::uint64_t seed) {
  SoakOptions options;
  options.rate = rate;
  options.length = std::chrono::milliseconds(2000);
  options.longest_calm = std::chrono::milliseconds(40);
  options.seed = seed;
  Soak soak(options);
  soak.run();
  for (const std::string& violation : soak.violations()) ADD_FAILURE() << violation;
  EXPECT_GT(soak.counts().rebalances, 0U);
  EXPECT_GT(soak.counts().pauses, 0U);
  EXPECT_GT(soak.counts().refused, 0U);
}

TEST(Soak, EveryTupleIsAccountedForAndNoKeyIsOutOfOrderAtFullLoadBetweenPausesAndRebalances) {
  soak(0, 1);
}

TEST(Soak, EveryTupleIsAccountedForAndNoKeyIsOutOfOrderWhenTasksOftenRunOut) {
  soak(20'000, 2);
}

}  // namespace
}  // namespace iotcloud::bench
