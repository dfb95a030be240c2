#include <gmock/gmock.h>
#include <gtest/gtest.h>

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
    looks_.saw(message);
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
