// How long and how often a server is asked to remove queues, on a clock that the test moves.
#include "iotcloud/brokers/rabbitmq/queue_remover.h"

#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/config/hand_clock.h"
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

using tests::eventually;

class RabbitMqQueueRemover : public testing::Test {
 protected:
  QueueRemover::Attempt attempt() {
    return [this](const std::vector<QueueRemover::Unneeded>& queues, std::vector<std::string>& answers) {
      const std::lock_guard lock(mutex_);
      for (const auto& unneeded : queues) {
        ++asked_[unneeded.queue];
        if (away_) throw LinkError("nobody listens");
        answers.push_back(in_use_);
      }
    };
  }
  int asked(const std::string& queue) const {
    const std::lock_guard lock(mutex_);
    const auto found = asked_.find(queue);
    return found == asked_.end() ? 0 : found->second;
  }
  void set_use(const std::string& why) {
    const std::lock_guard lock(mutex_);
    in_use_ = why;
  }
  void set_away() {
    const std::lock_guard lock(mutex_);
    away_ = true;
  }
  /// Waits until the thread waits for its next attempt.
  bool pauses() {
    return eventually([&] { return clock_.waiting() == 1; });
  }

  tests::HandClock clock_;

 private:
  mutable std::mutex mutex_;
  std::map<std::string, int> asked_;
  std::string in_use_;  ///< what the server answers
  bool away_ = false;
};

TEST_F(RabbitMqQueueRemover, AQueueInUseIsTriedAgainAfterAPauseOfTheInjectedClock) {
  set_use("406 in use");
  QueueRemover remover(attempt(), clock_);
  remover.remove("q");
  ASSERT_TRUE(pauses());
  EXPECT_EQ(asked("q"), 1);
  clock_.advance(QueueRemover::pause);
  ASSERT_TRUE(eventually([&] { return asked("q") == 2; }));
  ASSERT_TRUE(pauses());
  set_use("");
  clock_.advance(QueueRemover::pause);
  EXPECT_TRUE(eventually([&] { return asked("q") == 3; }));
}

TEST_F(RabbitMqQueueRemover, AQueueThatStaysInUseIsGivenUpWhenItsTimeIsUp) {
  set_use("406 in use");
  std::optional<QueueRemover> remover(std::in_place, attempt(), clock_);
  remover->remove("q");
  ASSERT_TRUE(pauses());
  clock_.advance(QueueRemover::patience);
  remover.reset();  // returns, although the server still keeps the queue
  EXPECT_EQ(asked("q"), 2);
}

TEST_F(RabbitMqQueueRemover, ItsEndWaitsForTheServerToTakeTheQueues) {
  set_use("406 in use");
  std::optional<QueueRemover> remover(std::in_place, attempt(), clock_);
  remover->remove("q");
  ASSERT_TRUE(pauses());
  std::jthread ending([&] { remover.reset(); });
  ASSERT_TRUE(eventually([&] { return asked("q") == 2; })) << "its end is told to the thread, which asks once more";
  ASSERT_TRUE(pauses());
  set_use("");
  clock_.advance(QueueRemover::pause);
  ending.join();
  EXPECT_EQ(asked("q"), 3);
}

TEST_F(RabbitMqQueueRemover, AServerThatCannotBeAskedIsNotWaitedFor) {
  set_away();
  std::optional<QueueRemover> remover(std::in_place, attempt(), clock_);
  remover->remove("q");
  remover.reset();
  EXPECT_EQ(asked("q"), 1);
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
