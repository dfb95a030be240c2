// The publishers' life over a connection whose every event the test decides.
#include "iotcloud/brokers/client/publish_core.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::client {
namespace {

using std::chrono::milliseconds;
using testing::Contains;
using testing::ElementsAre;
using testing::IsEmpty;

/// A clock that the test moves. A wait on it ends at once, at its time, after what the test wants to happen meanwhile.
class CoreClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  std::cv_status wait_until(config::ConditionVariable& /*changed*/, config::Mutex& mutex, Instant end) const override
      IOTCLOUD_REQUIRES(mutex) {
    const config::Unlocked unlocked(mutex);
    if (while_waiting) {
      std::exchange(while_waiting, nullptr)();
      return std::cv_status::no_timeout;
    }
    now_ = std::max(now_, end);
    return std::cv_status::timeout;
  }
  void advance(milliseconds by) { now_ += by; }

  mutable std::function<void()> while_waiting;  ///< called once

 private:
  mutable Instant now_{std::chrono::hours(1)};
};

/// Sends without the core's mutex, as real ones do while bytes move; whatever happens then is `meanwhile`.
class CoreTransport final : public PublishTransport {
 public:
  explicit CoreTransport(const config::Clock& clock) : meters_(&metrics_, "test"), core(*this, meters_, clock) {}

  void connect() {
    const config::MutexLock lock(core.mutex);
    connected_ = true;
    for (const auto& outbox : core.outboxes()) core.open(outbox);
  }
  void lose(bool one_by_one = false) {
    const config::MutexLock lock(core.mutex);
    const PublishCore::Turn turn(core);
    connected_ = false;
    given_.clear();
    core.connection_lost(one_by_one);
  }
  /// What its thread does when it is woken: timers, sending, reports.
  void work(std::size_t most = 1000) {
    const config::MutexLock lock(core.mutex);
    core.fire_timers();
    {
      const PublishCore::Turn turn(core);
      core.send_waiting(turn, most);
    }
    core.report();
  }
  enum class Answer { confirmed, refused, refused_for_now, returned, put_off };
  /// Answers the oldest message under way. \return whether there was one
  bool answer(Answer what = Answer::confirmed) {
    const config::MutexLock lock(core.mutex);
    if (given_.empty()) return false;
    UnderWay& message = *given_.front();
    given_.pop_front();
    if (what == Answer::confirmed) core.confirmed(message);
    if (what == Answer::refused) core.refused(message, "no");
    if (what == Answer::refused_for_now) core.refused_for_now(message, "403");
    if (what == Answer::returned) core.returned(message);
    if (what == Answer::put_off) core.put_off(message);
    return true;
  }
  void answer_all() {
    while (answer()) {
    }
  }
  std::size_t under_way() const {
    const config::MutexLock lock(core.mutex);
    return core.under_way().size();
  }
  bool has_waiting() const {
    const config::MutexLock lock(core.mutex);
    return core.has_waiting();
  }
  /// What was sent since the last call: topic, body, and "again" when it may be a second time.
  std::vector<std::string> take_sent() { return std::exchange(sent_, {}); }
  int take_wakes() { return std::exchange(wakes_, 0); }

  std::size_t space = 1000;                       ///< messages that fit into the socket's buffer
  std::function<void()> meanwhile;                ///< called once, while a message is sent
  std::map<std::string, PublishLane> lanes;       ///< by topic, of topics that have their own
  std::map<std::string, std::size_t> lane_space;  ///< messages that may be sent of such a topic
  std::string nowhere;                            ///< this topic has no way to the server
  int wanted = 0;                                 ///< so often somebody waited for answers
  std::string broke_because;

 private:
  void added(const std::shared_ptr<Outbox>& outbox) override {
    outbox->ready = connected_;
    if (const auto lane = lanes.find(outbox->topic.name); lane != lanes.end()) outbox->lane = &lane->second;
  }
  Room room(const std::shared_ptr<Outbox>& outbox, const Message& /*next*/, bool /*alone*/) override {
    if (outbox->topic.name == nowhere) return Room::not_for_this_publisher;
    if (!connected_ || space == 0) return Room::full;
    const auto own = lane_space.find(outbox->topic.name);
    return own == lane_space.end() || own->second > 0 ? Room::yes : Room::full;
  }
  void send(UnderWay& message) override IOTCLOUD_REQUIRES(core.mutex) {
    given_.push_back(&message);
    if (space > 0) --space;
    if (const auto own = lane_space.find(message.outbox->topic.name); own != lane_space.end()) --own->second;
    const AcceptedMessage& accepted = message.accepted;
    sent_.push_back(message.outbox->topic.name + " " + std::to_string(accepted.number) +
                    (accepted.resent || accepted.old ? " again" : ""));
    const config::Unlocked unlocked(core.mutex);
    if (meanwhile) std::exchange(meanwhile, nullptr)();
  }
  void broke(const char* why) noexcept override {
    broke_because = why;
    connected_ = false;
  }
  void left_waiting(const std::shared_ptr<Outbox>& /*outbox*/, Instant /*now*/) override { ++wakes_; }
  void want_answers() override { ++wanted; }
  void wake() noexcept override { ++wakes_; }

  config::Metrics metrics_;
  Meters meters_;
  bool connected_ = false;
  std::deque<UnderWay*> given_;  ///< without an answer
  std::vector<std::string> sent_;
  int wakes_ = 0;

 public:
  PublishCore core;
};

Message message_of(const std::string& body) {
  Message message;
  message.payload = Payload::copy(body);
  return message;
}

class PublishCoreTest : public testing::Test {
 protected:
  PublisherOptions options(std::size_t capacity = 100) {
    PublisherOptions options;
    options.capacity = capacity;
    options.on_outcome = [this](std::uint64_t number, Outcome outcome, const std::string& reason) {
      const std::map<Outcome, std::string> words{{Outcome::confirmed, "confirmed"},
                                                 {Outcome::refused, "refused"},
                                                 {Outcome::dropped, "dropped"},
                                                 {Outcome::unknown, "unknown"}};
      outcomes_.push_back(std::to_string(number) + " " + words.at(outcome) + (reason.empty() ? "" : " " + reason));
      if (on_outcome_) on_outcome_();
    };
    options.on_writable = [this] { ++writable_; };
    return options;
  }
  std::unique_ptr<CorePublisher> publisher(const std::string& topic, const PublisherOptions& options) {
    return std::make_unique<CorePublisher>(transport_.core, Topic{"", topic, false}, options);
  }
  std::unique_ptr<CorePublisher> publisher(const std::string& topic) { return publisher(topic, options()); }
  static void publish(CorePublisher& to, int count = 1) {
    for (int i = 0; i < count; ++i) ASSERT_EQ(to.publish(message_of("x")), PublishStatus::accepted);
  }
  /// Connects and gets a message of this publisher through: from now on it may send many at once.
  void prove(CorePublisher& publisher) {
    transport_.connect();
    publish(publisher);
    transport_.work();
    transport_.answer_all();
    transport_.work();
    transport_.take_sent();
    transport_.take_wakes();
    outcomes_.clear();
  }
  std::vector<std::string> outcomes() { return std::exchange(outcomes_, {}); }

  CoreClock clock_;
  CoreTransport transport_{clock_};
  std::vector<std::string> outcomes_;
  std::function<void()> on_outcome_;
  int writable_ = 0;
};

TEST_F(PublishCoreTest, TheOldestMessageWaitsOrIsUnderWay) {
  const auto a = publisher("a"), b = publisher("b");
  EXPECT_FALSE(a->oldest());
  publish(*a);
  const auto first = a->oldest();
  ASSERT_TRUE(first);
  EXPECT_EQ(*first, clock_.now());
  clock_.advance(std::chrono::seconds(1));
  publish(*a);
  publish(*b);
  EXPECT_EQ(a->oldest(), first);
  EXPECT_EQ(b->oldest(), clock_.now());
  transport_.connect();
  transport_.work();
  ASSERT_THAT(transport_.take_sent(), Contains("a 1"));
  EXPECT_EQ(a->oldest(), first) << "it is under way";
  transport_.answer_all();
  EXPECT_EQ(a->oldest(), clock_.now()) << "the second one is the oldest now";
}

TEST_F(PublishCoreTest, ACallerSendsItsMessageItselfAndWakesNobody) {
  const auto a = publisher("a");
  prove(*a);
  publish(*a, 3);
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3", "a 4"));
  EXPECT_EQ(transport_.take_wakes(), 0);
  transport_.answer_all();
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("2 confirmed", "3 confirmed", "4 confirmed"));
  EXPECT_EQ(a->pending(), 0U);
}

TEST_F(PublishCoreTest, BeforeThereIsAConnectionMessagesWaitAndLeaveInTheirOrder) {
  const auto a = publisher("a");
  publish(*a, 3);
  EXPECT_THAT(transport_.take_sent(), IsEmpty());
  transport_.connect();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 1")) << "alone: whether anybody reads the topic is not known yet";
  transport_.answer();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3"));
}

TEST_F(PublishCoreTest, WhatIsPublishedWhileAnotherThreadSendsIsSentByThatThread) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.meanwhile = [&] { std::thread([&] { publish(*b, 2); }).join(); };
  publish(*a);
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "b 2", "b 3"));
  EXPECT_EQ(transport_.take_wakes(), 0) << "nothing is left for the transport's thread";
}

TEST_F(PublishCoreTest, ACallerHelpsWithSixteenMessagesAndLeavesTheRestToTheTransport) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.meanwhile = [&] { std::thread([&] { publish(*b, 20); }).join(); };
  publish(*a);
  EXPECT_EQ(transport_.take_sent().size(), 17U);
  EXPECT_EQ(transport_.take_wakes(), 1);
  EXPECT_TRUE(transport_.has_waiting());
  transport_.work();
  EXPECT_EQ(transport_.take_sent().size(), 4U);
}

TEST_F(PublishCoreTest, AMessageForWhichThereIsNoRoomWaitsAndNothingOvertakesIt) {
  const auto a = publisher("a");
  prove(*a);
  transport_.space = 1;
  publish(*a, 2);
  EXPECT_EQ(transport_.take_wakes(), 1);
  transport_.space = 1000;
  publish(*a);
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2"));
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 3", "a 4"));
}

TEST_F(PublishCoreTest, TheAnswerMayComeBeforeTheCallThatSendsReturns) {
  const auto a = publisher("a");
  prove(*a);
  transport_.meanwhile = [&] { EXPECT_TRUE(transport_.answer()); };
  publish(*a);
  EXPECT_EQ(transport_.under_way(), 0U);
  EXPECT_EQ(transport_.take_wakes(), 1) << "its outcome is to be reported";
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("2 confirmed"));
}

TEST_F(PublishCoreTest, ASendThatFailsIsNotFeltByTheCallerAndTheMessageIsSentAgainMarked) {
  const auto a = publisher("a");
  prove(*a);
  transport_.meanwhile = [] { throw std::runtime_error("reset by peer"); };
  publish(*a);
  EXPECT_EQ(transport_.broke_because, "reset by peer");
  publish(*a);
  transport_.lose();
  transport_.take_sent();
  transport_.connect();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2 again"));
  transport_.answer();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 3")) << "it was never sent before";
}

TEST_F(PublishCoreTest, AConnectionThatIsLostWhileACallerSendsLosesNoMessageAndKeepsTheOrder) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  publish(*a, 2);
  transport_.meanwhile = [&] {
    publish(*b, 2);  // by another caller
    throw std::runtime_error("reset");
  };
  publish(*a);
  transport_.lose();
  transport_.take_sent();
  transport_.connect();
  for (int i = 0; i < 4; ++i) {
    transport_.work();
    transport_.answer_all();
  }
  EXPECT_THAT(transport_.take_sent(),
              testing::UnorderedElementsAre("a 2 again", "a 3 again", "a 4 again", "b 2", "b 3"));
  transport_.work();
  EXPECT_EQ(a->pending() + b->pending(), 0U);
}

TEST_F(PublishCoreTest, WhatIsRefusedForNowIsTriedAgainAfterAWhileAndNothingOvertakesIt) {
  using Answer = CoreTransport::Answer;
  const auto a = publisher("a");
  prove(*a);
  publish(*a, 3);
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3", "a 4"));
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(transport_.answer(Answer::refused_for_now));
  publish(*a);
  for (int tries = 0; tries < 20; ++tries) {
    transport_.work();
    EXPECT_THAT(transport_.take_sent(), IsEmpty()) << "try " << tries << " comes after a pause";
    clock_.advance(std::chrono::seconds(6));
    transport_.work();
    EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2"));
    EXPECT_TRUE(transport_.answer(Answer::refused_for_now));
  }
  EXPECT_THAT(outcomes(), IsEmpty());
  EXPECT_EQ(a->pending(), 4U);
  clock_.advance(std::chrono::seconds(6));
  transport_.work();
  transport_.answer_all();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3", "a 4", "a 5"));
  transport_.answer_all();
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("2 confirmed", "3 confirmed", "4 confirmed", "5 confirmed"));
}

TEST_F(PublishCoreTest, WhatIsRefusedForNowIsNotAskedForAtOnceWhenTheServerEndsTheChannelForIt) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  publish(*a);
  EXPECT_TRUE(transport_.answer(CoreTransport::Answer::refused_for_now));
  transport_.take_sent();
  publish(*b);
  transport_.lose(true);
  transport_.take_sent();
  transport_.connect();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("b 2 again"));
  transport_.answer_all();
  transport_.lose();
  transport_.connect();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2")) << "another connection may know other permissions";
}

TEST_F(PublishCoreTest, WhatIsRefusedForNowIsDroppedAtItsDeadline) {
  PublisherOptions options = this->options();
  options.deadline = milliseconds(500);
  const auto a = publisher("a", options);
  prove(*a);
  publish(*a);
  EXPECT_TRUE(transport_.answer(CoreTransport::Answer::refused_for_now));
  clock_.advance(milliseconds(600));
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("2 dropped deadline"));
}

TEST_F(PublishCoreTest, WhatMadeTheServerEndTheConnectionIsFoundBySendingOneByOne) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  publish(*a, 2);
  publish(*b, 2);
  transport_.lose(true);
  transport_.take_sent();
  transport_.connect();
  for (int i = 0; i < 4; ++i) {
    transport_.work();
    EXPECT_EQ(transport_.under_way(), 1U);
    publish(*a);
    EXPECT_EQ(transport_.under_way(), 1U) << "a new one does not go beside it either";
    EXPECT_TRUE(transport_.answer(i == 2 ? CoreTransport::Answer::refused : CoreTransport::Answer::confirmed));
  }
  transport_.work();
  EXPECT_GT(transport_.under_way(), 1U) << "the last of them is through";
}

TEST_F(PublishCoreTest, AFullPublisherSaysSoAndTellsOnceWhenThereIsRoomAgain) {
  const auto a = publisher("a", options(2));
  prove(*a);
  publish(*a, 2);
  EXPECT_EQ(a->publish(message_of("x")), PublishStatus::would_block);
  EXPECT_EQ(a->publish(message_of("x")), PublishStatus::would_block);
  EXPECT_EQ(transport_.wanted, 2) << "the answers make room";
  transport_.answer_all();
  EXPECT_EQ(writable_, 0);
  transport_.work();
  EXPECT_EQ(writable_, 1);
}

TEST_F(PublishCoreTest, AMessageThatWaitsIsDroppedAtItsDeadlineByTheInjectedClock) {
  PublisherOptions with_deadline = options();
  with_deadline.deadline = milliseconds(50);
  const auto a = publisher("a", with_deadline);
  publish(*a);
  EXPECT_GE(transport_.take_wakes(), 1) << "who sleeps learns of the new timer";
  clock_.advance(milliseconds(49));
  transport_.work();
  EXPECT_THAT(outcomes(), IsEmpty());
  clock_.advance(milliseconds(1));
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("1 dropped deadline"));
}

TEST_F(PublishCoreTest, WhatNobodyReadsIsTriedAgainLaterAndTheOnesBehindItWait) {
  const auto a = publisher("a");
  transport_.connect();
  publish(*a, 3);
  transport_.answer(CoreTransport::Answer::returned);
  transport_.take_sent();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), IsEmpty());
  clock_.advance(milliseconds(20));
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 1"));
  transport_.answer();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3"));
}

TEST_F(PublishCoreTest, WhatTheServerCouldNotStoreIsTriedAgainMarked) {
  const auto a = publisher("a");
  prove(*a);
  publish(*a);
  transport_.answer(CoreTransport::Answer::put_off);
  transport_.take_sent();
  clock_.advance(milliseconds(20));
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2 again"));
}

TEST_F(PublishCoreTest, AMessageThatNoBrokerTakesIsRefusedWithoutBeingSent) {
  const auto a = publisher("a");
  prove(*a);
  Message message = message_of("x");
  message.properties.set(std::string(1000, 'n'), "value");
  EXPECT_EQ(a->publish(std::move(message)), PublishStatus::accepted);
  EXPECT_EQ(transport_.take_wakes(), 1);
  transport_.work();
  EXPECT_THAT(outcomes(), ElementsAre("2 refused property_name_too_long"));
  EXPECT_THAT(transport_.take_sent(), IsEmpty());
}

TEST_F(PublishCoreTest, AClosedPublisherKnowsNothingOfWhatHasNoAnswerAndALateAnswerIsIgnored) {
  auto a = publisher("a");
  prove(*a);
  publish(*a, 2);
  a.reset();
  EXPECT_THAT(outcomes(), ElementsAre("2 unknown closed", "3 unknown closed"));
  transport_.answer_all();
  transport_.lose();
  transport_.work();
  EXPECT_THAT(outcomes(), IsEmpty());
}

TEST_F(PublishCoreTest, APublisherClosedWhileItsMessageIsSentIsNotSentAgainAfterALoss) {
  auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.meanwhile = [&] { std::thread([&] { b.reset(); }).join(); };
  publish(*b);
  publish(*a);
  transport_.lose();
  transport_.take_sent();
  transport_.connect();
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2 again"));
}

TEST_F(PublishCoreTest, APublisherMayEndInItsOwnCallbackOnWhicheverThreadThatRuns) {
  auto a = publisher("a");
  prove(*a);
  publish(*a);
  transport_.answer_all();
  on_outcome_ = [&] { a.reset(); };
  CorePublisher& still = *a;
  EXPECT_TRUE(still.drain(milliseconds(1))) << "here it runs on the thread that drains";
  EXPECT_EQ(a, nullptr);
}

TEST_F(PublishCoreTest, TheEndOfAPublisherWaitsForItsCallbackOnAnotherThread) {
  auto a = publisher("a");
  prove(*a);
  publish(*a);
  transport_.answer_all();
  std::atomic<bool> entered = false, ended = false;
  on_outcome_ = [&] {
    entered = true;
    for (int i = 0; i < 1000; ++i) std::this_thread::yield();  // gives the other thread a chance to be wrong
    ended = true;
  };
  std::thread reporting([&] { transport_.work(); });
  while (!entered) std::this_thread::yield();
  a.reset();
  EXPECT_TRUE(ended);
  reporting.join();
}

TEST_F(PublishCoreTest, DrainReportsHereWhatIsKnownAndGivesUpAtItsLimitOnTheInjectedClock) {
  const auto a = publisher("a");
  prove(*a);
  publish(*a, 2);
  transport_.answer();
  const auto before = clock_.now();
  EXPECT_FALSE(a->drain(milliseconds(70)));
  EXPECT_EQ(clock_.now() - before, milliseconds(70));
  EXPECT_THAT(outcomes(), ElementsAre("2 confirmed"));
  EXPECT_GE(transport_.wanted, 1);
  clock_.while_waiting = [&] { transport_.answer(); };
  EXPECT_TRUE(a->drain(milliseconds(70)));
  EXPECT_THAT(outcomes(), ElementsAre("3 confirmed"));
}

TEST_F(PublishCoreTest, ACallbackThatThrowsEndsNeitherThePublisherNorTheThread) {
  const auto a = publisher("a");
  prove(*a);
  on_outcome_ = [] { throw std::runtime_error("the user's own trouble"); };
  publish(*a);
  transport_.answer_all();
  transport_.work();
  EXPECT_EQ(a->pending(), 0U);
  on_outcome_ = nullptr;
  publish(*a);
  EXPECT_EQ(transport_.under_way(), 1U);
}

TEST_F(PublishCoreTest, PublishersOfALaneTakeTurns) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.space = 0;
  publish(*a, 3);
  publish(*b, 2);
  transport_.space = 1000;
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "b 2", "a 3", "b 3", "a 4"));
}

TEST_F(PublishCoreTest, ALaneThatIsFullHoldsUpNoOther) {
  transport_.lanes["a"];
  transport_.lanes["b"];
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.lane_space = {{"a", 1}, {"b", 1000}};
  publish(*a, 3);
  publish(*b, 2);
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "b 2", "b 3"));
  transport_.lane_space["a"] = 1;
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 3"));
}

TEST_F(PublishCoreTest, ATopicWithoutAWayHoldsUpNoOtherOfItsLane) {
  const auto a = publisher("a"), b = publisher("b");
  prove(*a);
  prove(*b);
  transport_.nowhere = "a";
  publish(*a);
  publish(*b);
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("b 2"));
  transport_.nowhere.clear();
  publish(*a);
  transport_.work();
  EXPECT_THAT(transport_.take_sent(), ElementsAre("a 2", "a 3"));
}

/// Many callers, a connection that breaks now and then, answers of all kinds: each message has one outcome, and what
/// arrives for the first time arrives in order.
TEST(PublishCoreStress, EachMessageHasOneOutcomeAndOrderIsKeptOverLosses) {
  constexpr int publishers = 3;
  constexpr int messages = 400;
  CoreTransport transport(config::system_clock());
  transport.space = 1'000'000;
  std::map<std::string, std::vector<std::atomic<int>>> outcomes;
  for (int p = 0; p < publishers; ++p) outcomes["t" + std::to_string(p)] = std::vector<std::atomic<int>>(messages + 1);
  std::atomic<bool> done = false;
  std::thread server([&] {
    std::minstd_rand random(17);
    while (!done) {
      transport.connect();
      for (int i = 0; i < 50; ++i) {
        transport.work(5);
        for (unsigned answers = random() % 8; answers > 0; --answers) transport.answer();
        std::this_thread::yield();
      }
      transport.lose(random() % 4 == 0);
    }
  });
  std::vector<std::thread> callers;
  callers.reserve(publishers);
  for (auto& [topic, counts] : outcomes) {
    callers.emplace_back([&transport, &topic = topic, &counts = counts] {
      PublisherOptions options;
      options.capacity = 16;
      options.on_outcome = [&](std::uint64_t number, Outcome outcome, const std::string&) {
        EXPECT_EQ(outcome, Outcome::confirmed);
        ++counts[number];
      };
      CorePublisher publisher(transport.core, Topic{"", topic, false}, options);
      for (int i = 0; i < messages;) {
        if (publisher.publish(message_of("x")) == PublishStatus::accepted) {
          ++i;
        } else {
          std::this_thread::yield();
        }
      }
      EXPECT_TRUE(publisher.drain(std::chrono::seconds(60)));
    });
  }
  for (std::thread& caller : callers) caller.join();
  done = true;
  server.join();
  for (const auto& [topic, counts] : outcomes) {
    for (int i = 1; i <= messages; ++i) EXPECT_EQ(counts[static_cast<std::size_t>(i)], 1) << topic << " " << i;
  }
  std::map<std::string, int> last;
  for (const std::string& sent : transport.take_sent()) {
    const std::string topic = sent.substr(0, 2);
    const int number = std::stoi(sent.substr(3));
    EXPECT_LE(number, last[topic] + 1) << topic << " before " << last[topic] + 1;
    last[topic] = std::max(last[topic], number);
  }
}

}  // namespace
}  // namespace iotcloud::brokers::client
