// What every broker guarantees for many messages of many drivers when its server dies in the middle.
#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <semaphore>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {
namespace {

constexpr std::size_t total = 50'000;
constexpr std::size_t drivers = 8;

/// The messages that arrived, by number. Thread safe.
class Arrivals {
 public:
  Handler handler() {
    return [this](Delivery delivery) {
      const std::size_t number = std::stoul(std::string(delivery.message.payload.text()));
      const bool marked = delivery.redelivered;
      delivery.settle(Settlement::accept);
      const std::lock_guard lock(mutex_);
      std::uint32_t& copies = copies_.at(number);
      if (copies++ > 0) {
        unmarked_ += marked ? 0 : 1;
        return;
      }
      std::size_t& last = last_[number % drivers];
      overtaken_ += number < last ? 1 : 0;
      last = std::max(last, number);
      if (++different_ == total / 4 || different_ == total) progress_.notify_all();
    };
  }
  bool wait_for(std::size_t count) {
    std::unique_lock lock(mutex_);
    return progress_.wait_for(lock, 2 * patience, [&] { return different_ >= count; });
  }
  std::size_t different() const { return read(different_); }
  std::size_t unmarked() const { return read(unmarked_); }    ///< further copies without a mark
  std::size_t overtaken() const { return read(overtaken_); }  ///< first copies behind a later message of their driver

 private:
  std::size_t read(const std::size_t& value) const {
    const std::lock_guard lock(mutex_);
    return value;
  }
  mutable std::mutex mutex_;
  std::condition_variable progress_;
  std::vector<std::uint32_t> copies_ = std::vector<std::uint32_t>(total + 1);
  std::array<std::size_t, drivers> last_{};
  std::size_t different_ = 0;
  std::size_t unmarked_ = 0;
  std::size_t overtaken_ = 0;
};

TEST_P(BrokerContract, FiftyThousandMessagesOutliveTheServersDeathInTheMiddle) {
  const auto sender = this->broker();
  const auto reader = this->broker();
  const Topic topic = this->topic(true);
  Arrivals arrivals;
  SubscriptionOptions reading;
  reading.group = "readers";
  const auto subscription = reader->subscribe(topic, reading, arrivals.handler());
  await_active(*subscription);
  std::atomic<std::size_t> confirmed{0};
  std::atomic<std::size_t> others{0};
  std::counting_semaphore<> writable(0);
  PublisherOptions options;
  options.capacity = 2000;
  options.on_outcome = [&](std::uint64_t, Outcome outcome, const std::string&) {
    ++(outcome == Outcome::confirmed ? confirmed : others);
  };
  options.on_writable = [&] { writable.release(); };
  const auto publisher = sender->publisher(topic, options);
  std::jthread stream([&] {
    for (std::size_t number = 1; number <= total; ++number) {
      Message message = text_message(std::to_string(number));
      message.driver_id = "driver-" + std::to_string(number % drivers);
      while (publisher->publish(message) != PublishStatus::accepted) {
        if (!writable.try_acquire_for(patience)) return;  // checked below: not all messages were sent
      }
    }
  });
  EXPECT_TRUE(arrivals.wait_for(total / 4));
  server().kill();
  server().start();
  stream.join();
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(confirmed, total);
  EXPECT_EQ(others, 0U);
  EXPECT_TRUE(arrivals.wait_for(total)) << arrivals.different() << " arrived";
  EXPECT_EQ(arrivals.unmarked(), 0U);
  EXPECT_EQ(arrivals.overtaken(), 0U);
}

}  // namespace
}  // namespace iotcloud::brokers
