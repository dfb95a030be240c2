#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/clock_name.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/tests/config/hand_clock.h>

namespace iotcloud::gateway {
namespace {

using discovery::ChannelLook;
using discovery::LookRequest;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

class ChannelLooksTest : public ::testing::Test {
 protected:
  ChannelLook ask(const std::string& name, std::int32_t most = 10, std::int32_t bytes = 100, bool last = false) {
    LookRequest request;
    request.look = name;
    request.channel = "readings";
    request.most = most;
    request.bytes = bytes;
    request.last = last;
    ChannelLook look;
    looks_.answer(request, look);
    return look;
  }
  void carry(const std::string& text) {
    brokers::Message message;
    message.payload = brokers::Payload::copy(text);
    message.properties.set("unit", "C");
    message.time_ms = 7;
    looks_.saw(message, {});
  }
  /// Carries a message of that time, and asks for its times. \param key names it
  void carry_timed(std::int64_t time_ms, std::uint64_t key) {
    brokers::Message message;
    message.time_ms = time_ms;
    looks_.saw(message, {key, clock_.now(), clock_.now() - 3ms});
  }
  ChannelLook ask_for_times() {
    LookRequest request;
    request.look = "times";
    request.most = 10;
    request.every_ms = 100;
    ChannelLook look;
    looks_.answer(request, look);
    return look;
  }

  tests::HandClock clock_;
  ChannelLooks looks_{clock_};
};

TEST_F(ChannelLooksTest, ALookGetsWhatCameSinceItsLastQuestionAndCountsFromItsBeginning) {
  EXPECT_FALSE(looks_.watched());
  EXPECT_EQ(ask("a").count, 0);
  EXPECT_TRUE(looks_.watched());
  carry("one");
  clock_.advance(20ms);
  carry("three");
  clock_.advance(80ms);
  const auto first = ask("a");
  EXPECT_EQ(first.count, 2);
  EXPECT_EQ(first.bytes, 8);
  EXPECT_EQ(first.elapsed_us, 100'000);
  EXPECT_EQ(first.shortest_us, 20'000);
  EXPECT_EQ(first.longest_us, 20'000);
  EXPECT_EQ(first.smallest, 3);
  EXPECT_EQ(first.largest, 5);
  ASSERT_EQ(first.messages.size(), 2U);
  EXPECT_EQ(first.messages[1].number, 2);
  EXPECT_EQ(first.messages[1].payload, "three");
  EXPECT_EQ(first.messages[1].time_ms, 7);
  EXPECT_EQ(first.messages[1].properties.at("unit"), "C");
  const auto second = ask("a", 10, 100, true);
  EXPECT_TRUE(second.messages.empty());
  EXPECT_EQ(second.longest_us, 0);
  EXPECT_FALSE(looks_.watched()) << "the last look has ended";
}

TEST_F(ChannelLooksTest, ASampleIsBoundedAndWhatIsNotInItIsCounted) {
  ask("few", 2, 3);
  ask("counts", 0);
  for (int i = 0; i < 5; ++i) carry("longer");
  const auto few = ask("few", 2, 3);
  ASSERT_EQ(few.messages.size(), 2U);
  EXPECT_EQ(few.messages[0].payload, "lon");
  EXPECT_EQ(few.messages[0].size, 6);
  EXPECT_EQ(few.missed, 3);
  const auto counts = ask("counts", 0);
  EXPECT_EQ(counts.count, 5);
  EXPECT_EQ(counts.missed, 0);
  EXPECT_TRUE(counts.messages.empty());
  ask("large", discovery::most_seen_messages, discovery::most_seen_bytes);
  for (int i = 0; i < 3; ++i) carry(std::string(100'000, 'x'));
  const auto large = ask("large");
  EXPECT_EQ(large.messages.size(), 2U) << "256 KiB at most";
  EXPECT_EQ(large.missed, 1);
}

TEST_F(ChannelLooksTest, ALookForTimesKeepsTheFirstMessageOfEachSpanUntilItsEndIsKnown) {
  ask_for_times();
  carry_timed(1000, 1);
  carry_timed(1099, 2);  // of the same 100 ms as the first
  carry_timed(1100, 3);
  EXPECT_TRUE(ask_for_times().messages.empty()) << "no end is known";
  clock_.advance(5ms);
  looks_.ended(3, "dropped: superseded");
  const auto first = ask_for_times();
  ASSERT_EQ(first.messages.size(), 1U);
  EXPECT_EQ(first.messages[0].time_ms, 1100);
  EXPECT_EQ(first.messages[0].end_us - first.messages[0].begin_us, 5'000);
  EXPECT_EQ(first.messages[0].begin_us - first.messages[0].came_us, 3'000);
  EXPECT_EQ(first.messages[0].fate, "dropped: superseded");
  EXPECT_EQ(first.clock, config::system_clock_name());
  EXPECT_EQ(first.missed, 0) << "messages that were not chosen are not missed";
  clock_.advance(ChannelLooks::longest_wait);
  const auto second = ask_for_times();
  ASSERT_EQ(second.messages.size(), 1U) << "told without its end after a while";
  EXPECT_EQ(second.messages[0].time_ms, 1000);
  EXPECT_EQ(second.messages[0].end_us, 0);
}

TEST_F(ChannelLooksTest, TheEndOfAMessageMayComeBeforeTheMessageIsSeen) {
  ask_for_times();
  looks_.ended(7, "confirmed");
  carry_timed(1, 7);
  const auto look = ask_for_times();
  ASSERT_EQ(look.messages.size(), 1U);
  EXPECT_EQ(look.messages[0].fate, "confirmed");
}

TEST_F(ChannelLooksTest, ALookThatNobodyAsksForEnds) {
  ask("a");
  clock_.advance(ChannelLooks::longest_silence);
  carry("one");
  EXPECT_FALSE(looks_.watched());
  EXPECT_EQ(ask("a").count, 0) << "it is a new look";
}

TEST_F(ChannelLooksTest, TooManyLooksAreRefused) {
  for (std::size_t i = 0; i < ChannelLooks::most_looks; ++i) EXPECT_EQ(ask(std::to_string(i)).problem, "");
  EXPECT_THAT(ask("one more").problem, HasSubstr("8 others look at channel \"readings\" now"));
  ask("0", 0, 0, true);
  EXPECT_EQ(ask("one more").problem, "");
}

}  // namespace
}  // namespace iotcloud::gateway
