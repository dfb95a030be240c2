// What the log says of a flood of refused clients.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/rpc/refusal_log.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>

namespace iotcloud::rpc {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(RefusalLogTest, SaysTheFirstOfEachKindAndThenOneAMinuteWithTheNumberOfTheOthers) {
  tests::HandClock clock;
  RefusalLog log(config::Logger{"test"}, clock);
  const tests::CapturedLog captured;
  log.refused("tls", "A");
  log.refused("tls", "B");
  log.refused("slow", "C");
  clock.advance(RefusalLog::pause - std::chrono::seconds(1));
  log.refused("tls", "D");
  clock.advance(std::chrono::seconds(1));
  log.refused("tls", "E");
  clock.advance(RefusalLog::pause);
  log.refused("tls", "F");
  EXPECT_THAT(captured.text(), AllOf(HasSubstr(" A\n"), Not(HasSubstr(" B")), HasSubstr(" C\n"), Not(HasSubstr(" D")),
                                     HasSubstr(" E; and 2 more of this kind"), HasSubstr(" F\n")));
}

}  // namespace
}  // namespace iotcloud::rpc
