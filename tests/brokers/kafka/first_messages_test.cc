#include "iotcloud/brokers/kafka/first_messages.h"

#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>

namespace iotcloud::brokers::kafka {
namespace {

using std::chrono::milliseconds;

class StillClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  std::cv_status wait_until(config::ConditionVariable&, config::Mutex&, Instant end) const override {
    now_ = end;
    return std::cv_status::timeout;
  }
  void advance(milliseconds by) { now_ += by; }

 private:
  mutable Instant now_{std::chrono::hours(1)};
};

/// One key for each partition.
std::vector<std::string> keys_of(int partitions) {
  std::vector<std::string> keys(static_cast<std::size_t>(partitions));
  std::set<std::int32_t> found;
  for (int i = 0; found.size() < keys.size(); ++i) {
    const std::string key = "driver-" + std::to_string(i);
    const std::int32_t partition =
        rd_kafka_msg_partitioner_murmur2(nullptr, key.data(), key.size(), partitions, nullptr, nullptr);
    if (found.insert(partition).second) keys[static_cast<std::size_t>(partition)] = key;
  }
  return keys;
}

TEST(FirstMessagesTest, GoAloneAndLaterOnesTogether) {
  const StillClock clock;
  FirstMessages messages;
  messages.begin_anew(1);
  EXPECT_TRUE(messages.takes("a", clock));
  messages.sent("a", clock);
  EXPECT_FALSE(messages.takes("a", clock));
  EXPECT_FALSE(messages.takes("b", clock)) << "another driver, the same partition";
  messages.answered("a", true);
  for (int i = 0; i < 10; ++i) {
    EXPECT_TRUE(messages.takes("b", clock));
    messages.sent("b", clock);
  }
}

TEST(FirstMessagesTest, OfEachPartitionGoByThemselves) {
  const StillClock clock;
  const std::vector<std::string> keys = keys_of(4);
  FirstMessages messages;
  messages.begin_anew(4);
  for (const auto& key : keys) {
    EXPECT_TRUE(messages.takes(key, clock));
    messages.sent(key, clock);
  }
  messages.answered(keys[2], true);
  for (const auto& key : keys) EXPECT_EQ(messages.takes(key, clock), key == keys[2]);
}

TEST(FirstMessagesTest, ThatFailAreFollowedByAnotherFirstOne) {
  const StillClock clock;
  FirstMessages messages;
  messages.begin_anew(1);
  messages.sent("a", clock);
  messages.answered("a", false);
  EXPECT_TRUE(messages.takes("a", clock));
  messages.sent("a", clock);
  EXPECT_FALSE(messages.takes("a", clock));
}

TEST(FirstMessagesTest, DoNotHoldUpTheirTopicForEverWhenNoServerAnswers) {
  StillClock clock;
  FirstMessages messages;
  messages.begin_anew(1);
  messages.sent("a", clock);
  EXPECT_EQ(messages.waits_until(), FirstMessages::Instant{});
  clock.advance(milliseconds(10));
  EXPECT_FALSE(messages.takes("a", clock));
  EXPECT_EQ(messages.waits_until(), clock.now() - milliseconds(10) + FirstMessages::longest_wait);
  clock.advance(FirstMessages::longest_wait);
  EXPECT_TRUE(messages.takes("a", clock));
  messages.answered("a", true);
  EXPECT_EQ(messages.waits_until(), FirstMessages::Instant{});
}

}  // namespace
}  // namespace iotcloud::brokers::kafka
