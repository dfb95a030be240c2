#include <memory>
#include <string>

#include <gtest/gtest.h>

#include "iotcloud/brokers/embedded/queue.h"

namespace iotcloud::brokers::embedded {
namespace {

constexpr Instant start{};

Message message(const std::string& body) {
  Message message;
  message.payload = Payload::copy(body);
  return message;
}

std::string pop(Queue& queue, Instant now = start) {
  const auto stored = queue.pop(now);
  return stored ? std::string(stored->message.payload.text()) : "";
}

std::shared_ptr<Consumer> reader(bool exclusive) {
  auto consumer = std::make_shared<Consumer>();
  consumer->options.exclusive = exclusive;
  return consumer;
}

TEST(EmbeddedQueueTest, PutsAMessageBackInItsOldPlace) {
  Queue queue("q", false);
  for (const char* body : {"1", "2", "3"}) queue.push(message(body), {});
  auto first = queue.pop(start);
  auto second = queue.pop(start);
  ASSERT_TRUE(first && second);
  queue.put_back(std::move(*second));
  queue.put_back(std::move(*first));
  const auto again = queue.pop(start);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->message.payload.text(), "1");
  EXPECT_TRUE(again->redelivered);
  EXPECT_EQ(pop(queue), "2");
  EXPECT_EQ(pop(queue), "3");
}

TEST(EmbeddedQueueTest, SkipsWhatHasExpired) {
  Queue queue("q", false);
  queue.push(message("old"), start + std::chrono::milliseconds(10));
  queue.push(message("lasting"), {});
  EXPECT_EQ(pop(queue, start + std::chrono::milliseconds(10)), "lasting");
  EXPECT_EQ(queue.bytes(), 0U);
}

TEST(EmbeddedQueueTest, LetsExclusiveReadersTakeTurnsInTheOrderTheyCame) {
  Queue queue("q", false);
  const auto first = reader(true);
  const auto second = reader(true);
  const auto third = reader(false);
  for (const auto& consumer : {first, second, third}) queue.attach(consumer);
  EXPECT_TRUE(first->active);
  EXPECT_FALSE(second->active || third->active);
  queue.detach(*first, start);
  EXPECT_TRUE(second->active);
  EXPECT_FALSE(third->active);
  queue.detach(*second, start);
  EXPECT_TRUE(third->active);
}

TEST(EmbeddedQueueTest, AnExclusiveReaderWaitsUntilTheSharedOnesAreGone) {
  Queue queue("q", false);
  const auto one = reader(false);
  const auto other = reader(false);
  const auto exclusive = reader(true);
  for (const auto& consumer : {one, other, exclusive}) queue.attach(consumer);
  EXPECT_TRUE(one->active && other->active);
  EXPECT_FALSE(exclusive->active);
  queue.detach(*one, start);
  EXPECT_FALSE(exclusive->active);
  queue.detach(*other, start);
  EXPECT_TRUE(exclusive->active);
}

TEST(EmbeddedQueueTest, CountsItsBytesThroughEveryPath) {
  Queue queue("q", false);
  for (int i = 0; i < 10; ++i) queue.push(message("body"), {});
  const std::size_t each = queue.bytes() / 10;
  EXPECT_EQ(queue.trim(6), 4U);
  EXPECT_EQ(queue.bytes(), 6 * each);
  auto taken = queue.pop(start);
  EXPECT_EQ(queue.bytes(), 5 * each);
  queue.put_back(std::move(*taken));
  EXPECT_EQ(queue.bytes(), 6 * each);
  EXPECT_EQ(pop(queue), "body");
}

}  // namespace
}  // namespace iotcloud::brokers::embedded
