// The subscriptions' life over a connection whose every event the test decides.
#include "iotcloud/brokers/client/read_core.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
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
using testing::ElementsAre;
using testing::IsEmpty;

class ReadClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  void advance(milliseconds by) { now_ += by; }

 private:
  Instant now_{std::chrono::hours(1)};
};

class ReadLink;

/// A subscription on its own channel, as RabbitMQ's.
class LinkReader final : public OwnDeliveryStream {
 public:
  LinkReader(ReadLink& link, const std::string& name, SubscriptionOptions how, Handler what)
      : OwnDeliveryStream(Topic{"", name, false}, std::move(how), std::move(what)), link_(link) {}
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  std::deque<std::string> in_server;  ///< what fetch() takes from
  std::uint64_t last_tag = 0;         ///< of this channel

 private:
  ReadLink& link_;
};

/// What the core stands on here: it hands on when the test says so.
class ReadLink final : public ReadTransport {
 public:
  explicit ReadLink(const config::Clock& clock)
      : meters_(&metrics_, "test"), core(*this, meters_, clock, milliseconds(2)) {}

  void deliver(LinkReader& reader, const std::string& body, bool redelivered = false) {
    const config::MutexLock lock(core.mutex);
    take(reader, body, redelivered);
  }
  /// Runs handlers of what is ready. \return how many ran
  int hand_on(int most = 1000) {
    const config::MutexLock lock(core.mutex);
    ReadCore::Turn turn(core);
    int count = 0;
    for (; turn && count < most && core.take(turn) != nullptr; ++count) core.run(turn);
    return count;
  }
  /// What the server is told now: "2" one message, "<=2" all up to that one, "-2" and "-<=2" the same for rejections.
  std::vector<std::string> tell() {
    const config::MutexLock lock(core.mutex);
    std::vector<std::string> told;
    for (const auto& stream : core.take_dirty()) {
      for (const AckWindow::Action& action : stream->window.take(0)) {
        told.push_back((action.kind == AckWindow::Kind::reject ? "-" : "") + std::string(action.multiple ? "<=" : "") +
                       std::to_string(action.tag));
      }
    }
    return told;
  }
  /// The connection is gone; the next one counts anew.
  void lose(LinkReader& reader) {
    const config::MutexLock lock(core.mutex);
    core.connection_lost();
    reader.begin_anew();
    reader.last_tag = 0;
  }
  void pause(LinkReader& reader) {
    const config::MutexLock lock(core.mutex);
    core.pause(reader);
  }
  void resume(LinkReader& reader) {
    const config::MutexLock lock(core.mutex);
    core.resume(reader);
  }
  void remove(LinkReader& reader) {
    const config::MutexLock lock(core.mutex);
    core.end(reader);
    core.await_handler(reader);
  }
  bool has_ended(const LinkReader& reader) const {
    const config::MutexLock lock(core.mutex);
    return reader.closed;
  }
  bool has_ready() const {
    const config::MutexLock lock(core.mutex);
    return core.has_ready();
  }
  bool due() const {
    const config::MutexLock lock(core.mutex);
    return core.settlements_due();
  }
  void stop() {
    const config::MutexLock lock(core.mutex);
    core.stop();
  }
  int take_wakes() { return wakes_.exchange(0); }
  std::uint64_t counted(const std::string& name) { return metrics_.counter(name, "", {{"broker", "test"}}).value(); }

  std::atomic<int> settlements = 0;        ///< so often the core said that something is settled
  std::atomic<int> first_settlements = 0;  ///< of these: the first since tell()
  int room = 0;                            ///< messages that fetch() may take

 private:
  void settled(DeliveryStream& /*stream*/, bool first) noexcept override {
    ++settlements;
    if (first) ++first_settlements;
  }
  void wake() noexcept override { ++wakes_; }
  bool fetch(DeliveryStream& stream) override IOTCLOUD_REQUIRES(core.mutex) {
    auto& reader = static_cast<LinkReader&>(stream);
    for (; room > 0 && !reader.in_server.empty(); --room) {
      take(reader, reader.in_server.front(), false);
      reader.in_server.pop_front();
    }
    reader.more = !reader.in_server.empty();
    return reader.more && room > 0;
  }
  void take(LinkReader& reader, const std::string& body, bool redelivered) IOTCLOUD_REQUIRES(core.mutex) {
    Message message;
    message.payload = Payload::copy(body);
    ASSERT_TRUE(core.arrived(reader, {std::move(message), redelivered, ++reader.last_tag, 0}));
  }

  config::Metrics metrics_;
  Meters meters_;
  std::atomic<int> wakes_ = 0;

 public:
  ReadCore core;
};

void LinkReader::settle(std::uint64_t tag, Settlement settlement) noexcept {
  const config::MutexLock lock(link_.core.mutex);
  link_.core.settle(*this, tag, settlement);
}

class ReadCoreTest : public testing::Test {
 protected:
  /// A reader whose handler notes the message, does `on_message_`, and keeps the delivery.
  std::shared_ptr<LinkReader> reader(const std::string& topic, const SubscriptionOptions& options = {}) {
    return std::make_shared<LinkReader>(link_, topic, options, [this, topic](Delivery delivery) {
      seen_.push_back(topic + " " + std::string(delivery.message.payload.text()) +
                      (delivery.redelivered ? " again" : "") +
                      (delivery.tries > 1 ? " try " + std::to_string(delivery.tries) : ""));
      held_.push_back(std::move(delivery));
      if (on_message_) on_message_();
    });
  }
  void deliver(LinkReader& reader, const std::vector<std::string>& bodies) {
    for (const std::string& body : bodies) link_.deliver(reader, body);
  }
  std::vector<std::string> seen() { return std::exchange(seen_, {}); }
  void settle_all(Settlement settlement) {
    for (Delivery& delivery : held_) delivery.settle(settlement);
    held_.clear();
  }

  ReadClock clock_;
  ReadLink link_{clock_};
  std::vector<std::string> seen_;
  std::deque<Delivery> held_;
  std::function<void()> on_message_;
};

TEST_F(ReadCoreTest, HandsOnInOrderAndTellsTheServerOfManyAtOnce) {
  const auto a = reader("a");
  deliver(*a, {"1", "2", "3"});
  EXPECT_EQ(link_.hand_on(), 3);
  EXPECT_THAT(seen(), ElementsAre("a 1", "a 2", "a 3"));
  EXPECT_THAT(link_.tell(), IsEmpty());
  settle_all(Settlement::accept);
  EXPECT_EQ(link_.settlements, 3);
  EXPECT_THAT(link_.tell(), ElementsAre("<=3"));
  EXPECT_THAT(link_.tell(), IsEmpty());
}

TEST_F(ReadCoreTest, SaysWhichSettlementIsTheFirstSinceTheServerWasTold) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1", "2", "3"});
  deliver(*b, {"1"});
  link_.hand_on();
  held_[0].settle(Settlement::accept);  // a 1, b 1, a 2, a 3
  held_[2].settle(Settlement::accept);
  EXPECT_EQ(link_.first_settlements, 1);
  held_[1].settle(Settlement::accept);
  EXPECT_EQ(link_.first_settlements, 2);
  {
    const config::MutexLock lock(link_.core.mutex);
    link_.core.take_dirty(*a);
    EXPECT_THAT(link_.core.dirty(), ElementsAre(b));
  }
  held_[3].settle(Settlement::accept);
  EXPECT_EQ(link_.first_settlements, 3);
}

TEST_F(ReadCoreTest, ReadersTakeTurns) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1", "2", "3"});
  deliver(*b, {"1", "2"});
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1", "b 1", "a 2", "b 2", "a 3"));
}

TEST_F(ReadCoreTest, WhatIsToBeRetriedGoesBeforeWhatCameLater) {
  const auto a = reader("a");
  deliver(*a, {"1", "2", "3", "4"});
  link_.hand_on(3);
  seen();
  link_.take_wakes();
  held_[1].settle(Settlement::retry);
  held_[0].settle(Settlement::retry);
  EXPECT_EQ(link_.take_wakes(), 2) << "the thread that hands on may sleep";
  EXPECT_EQ(link_.settlements, 0) << "the server is told nothing of a retry";
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1 again try 2", "a 2 again try 2", "a 4"));
}

TEST_F(ReadCoreTest, ADeliveryThatNobodySettlesIsRetried) {
  const auto a = reader("a");
  deliver(*a, {"1"});
  link_.hand_on();
  held_.clear();
  seen();
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1 again try 2"));
}

TEST_F(ReadCoreTest, AHandlerThatThrowsGetsItsMessageAgainBeforeTheNext) {
  bool thrown = false;
  const auto a = std::make_shared<LinkReader>(link_, "a", SubscriptionOptions(), [&](Delivery delivery) {
    seen_.emplace_back(delivery.message.payload.text());
    if (!std::exchange(thrown, true)) throw std::runtime_error("the user's own trouble");
    delivery.settle(Settlement::accept);
  });
  deliver(*a, {"1", "2"});
  EXPECT_EQ(link_.hand_on(), 3);
  EXPECT_THAT(seen(), ElementsAre("1", "1", "2"));
  EXPECT_THAT(link_.tell(), ElementsAre("<=2"));
}

TEST_F(ReadCoreTest, KeepLastHandsOnTheNewestAndCountsAndAcceptsTheOthers) {
  SubscriptionOptions options;
  options.keep_last = 2;
  const auto a = reader("a", options);
  deliver(*a, {"1", "2", "3", "4", "5"});
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 4", "a 5"));
  EXPECT_EQ(link_.counted("iotcloud_broker_conflated_total"), 3U);
  EXPECT_EQ(link_.counted("iotcloud_broker_received_total"), 2U);
  EXPECT_THAT(link_.tell(), ElementsAre("<=3"));
}

TEST_F(ReadCoreTest, WithAutomaticAcknowledgementAMessageIsAcceptedBeforeItsHandlerRuns) {
  SubscriptionOptions options;
  options.automatic_ack = true;
  const auto a = reader("a", options);
  std::vector<std::string> told;
  on_message_ = [&] { told = link_.tell(); };
  deliver(*a, {"1"});
  link_.hand_on();
  EXPECT_THAT(told, ElementsAre("<=1"));
  settle_all(Settlement::retry);
  EXPECT_EQ(link_.hand_on(), 0) << "there is nothing to settle";
}

TEST_F(ReadCoreTest, APauseInTheMiddleOfABatchTakesEffectBehindTheHandlerThatRuns) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1", "2", "3"});
  deliver(*b, {"1", "2"});
  on_message_ = [&] {
    if (seen_.back() == "a 2") link_.pause(*a);
  };
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1", "b 1", "a 2", "b 2"));
  deliver(*a, {"4"});
  EXPECT_EQ(link_.hand_on(), 0);
  link_.take_wakes();
  link_.resume(*a);
  EXPECT_EQ(link_.take_wakes(), 1);
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 3", "a 4"));
}

TEST_F(ReadCoreTest, TheEndOfASubscriptionWaitsForItsHandlerOnAnotherThread) {
  const auto a = reader("a");
  deliver(*a, {"1", "2"});
  std::atomic<bool> entered = false, ended = false;
  on_message_ = [&] {
    entered = true;
    while (!link_.has_ended(*a)) std::this_thread::yield();
    for (int i = 0; i < 1000; ++i) std::this_thread::yield();  // gives the other thread a chance to be wrong
    ended = true;
  };
  std::thread handing_on([&] { link_.hand_on(); });
  while (!entered) std::this_thread::yield();
  link_.remove(*a);
  EXPECT_TRUE(ended);
  handing_on.join();
  EXPECT_THAT(seen(), ElementsAre("a 1")) << "nothing is handed on behind the end";
}

TEST_F(ReadCoreTest, ManyStreamsMayWaitForTheirHandlersAndGiveUpAtTheirLimit) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1"});
  deliver(*b, {"1"});
  std::atomic<bool> entered = false, given_up = false, ended = false;
  on_message_ = [&] {
    entered = true;
    while (!given_up) std::this_thread::yield();
    for (int i = 0; i < 1000; ++i) std::this_thread::yield();
    ended = true;
  };
  std::thread handing_on([&] { link_.hand_on(1); });
  while (!entered) std::this_thread::yield();
  {
    const config::MutexLock lock(link_.core.mutex);
    link_.core.await_handlers({b}, clock_.now() + std::chrono::hours(1));  // does not run
    link_.core.await_handlers({a, b}, clock_.now());
    EXPECT_TRUE(a->DeliveryStream::running);
  }
  given_up = true;
  {
    const config::MutexLock lock(link_.core.mutex);
    link_.core.await_handlers({a, b}, clock_.now() + std::chrono::hours(1));
  }
  EXPECT_TRUE(ended);
  handing_on.join();
}

TEST_F(ReadCoreTest, ASubscriptionMayEndInItsOwnHandler) {
  auto a = reader("a");
  const auto b = reader("b");
  deliver(*a, {"1", "2"});
  deliver(*b, {"1"});
  on_message_ = [&] {
    if (!a) return;
    link_.remove(*a);
    a.reset();
  };
  EXPECT_EQ(link_.hand_on(), 2);
  EXPECT_THAT(seen(), ElementsAre("a 1", "b 1"));
}

TEST_F(ReadCoreTest, ASubscriptionMayEndInAnothersHandler) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1"});
  deliver(*b, {"1"});
  on_message_ = [&] { link_.remove(*b); };
  EXPECT_EQ(link_.hand_on(), 1);
  EXPECT_THAT(seen(), ElementsAre("a 1"));
}

TEST_F(ReadCoreTest, WhatIsSettledBehindTheEndOfItsSubscriptionIsLate) {
  const auto a = reader("a");
  deliver(*a, {"1"});
  link_.hand_on();
  link_.remove(*a);
  settle_all(Settlement::accept);
  EXPECT_EQ(link_.settlements, 0);
  EXPECT_THAT(link_.tell(), IsEmpty());
}

TEST_F(ReadCoreTest, AnotherThreadMaySettleWhileAHandlerRuns) {
  const auto a = reader("a");
  deliver(*a, {"1", "2"});
  on_message_ = [&] {
    if (seen_.size() < 2) return;
    std::thread([&] { held_.front().settle(Settlement::accept); }).join();
    EXPECT_THAT(link_.tell(), ElementsAre("<=1"));
  };
  EXPECT_EQ(link_.hand_on(), 2);
  EXPECT_EQ(link_.settlements, 1);
}

TEST_F(ReadCoreTest, OnlyOneThreadHandsOn) {
  const auto a = reader("a"), b = reader("b");
  deliver(*a, {"1"});
  deliver(*b, {"1"});
  int others = -1;
  on_message_ = [&] {
    if (others < 0) std::thread([&] { others = link_.hand_on(); }).join();
  };
  EXPECT_EQ(link_.hand_on(), 2);
  EXPECT_EQ(others, 0);
}

TEST_F(ReadCoreTest, ALostConnectionTakesWhatWaitsAndWhatIsSettledLateForTheOldOneChangesNothing) {
  const auto a = reader("a");
  deliver(*a, {"1", "2", "3"});
  link_.hand_on(2);
  held_[0].settle(Settlement::accept);
  link_.lose(*a);
  EXPECT_THAT(link_.tell(), IsEmpty()) << "there is nobody to tell";
  EXPECT_EQ(link_.hand_on(), 0);
  seen();
  link_.deliver(*a, "1", true);
  link_.deliver(*a, "2", true);
  link_.deliver(*a, "3");
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1 again", "a 2 again", "a 3"));
  held_[1].settle(Settlement::accept);  // its tag is another message's now
  EXPECT_EQ(link_.settlements, 1);
  settle_all(Settlement::accept);
  EXPECT_THAT(link_.tell(), ElementsAre("<=3"));
}

TEST_F(ReadCoreTest, AConnectionLostWhileAHandlerRunsMakesItsSettlementLate) {
  const auto a = reader("a");
  deliver(*a, {"1"});
  on_message_ = [&] {
    link_.lose(*a);
    settle_all(Settlement::accept);
  };
  link_.hand_on();
  EXPECT_EQ(link_.settlements, 0);
}

TEST_F(ReadCoreTest, WhatIsTakenBackIsHandedOnAgainBeforeTheRest) {
  const auto a = reader("a");
  deliver(*a, {"1", "2", "3"});
  link_.hand_on(2);
  seen();
  {
    const config::MutexLock lock(link_.core.mutex);
    a->take_back();
    link_.core.make_ready(*a);
  }
  settle_all(Settlement::accept);
  EXPECT_EQ(link_.settlements, 0) << "what settled it is late";
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1 again try 2", "a 2 again try 2", "a 3"));
}

TEST_F(ReadCoreTest, RejectedAndSkippedMessagesAreToldInTheirPlace) {
  const auto a = reader("a");
  deliver(*a, {"1", "2"});
  {
    const config::MutexLock lock(link_.core.mutex);
    ++a->last_tag;
    link_.core.skipped(*a);
  }
  deliver(*a, {"4"});
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1", "a 2", "a 4"));
  held_[0].settle(Settlement::accept);
  held_[1].settle(Settlement::reject);
  held_[2].settle(Settlement::accept);
  EXPECT_THAT(link_.tell(), ElementsAre("<=1", "-<=2", "<=4"));
}

TEST_F(ReadCoreTest, ATagThatIsNotTheNextOneIsRefused) {
  const auto a = reader("a");
  const config::MutexLock lock(link_.core.mutex);
  EXPECT_FALSE(link_.core.arrived(*a, {{}, false, 7, 0}));
  EXPECT_FALSE(link_.core.has_ready());
}

TEST_F(ReadCoreTest, SettlementsGatherForAWhileUnlessTheyUseUpThePrefetch) {
  SubscriptionOptions options;
  options.prefetch = 4;
  const auto a = reader("a", options);
  deliver(*a, {"1", "2", "3", "4", "5"});
  link_.hand_on();
  EXPECT_FALSE(link_.due());
  held_[0].settle(Settlement::accept);
  EXPECT_TRUE(link_.due()) << "the last ones were told long ago";
  link_.tell();
  held_[1].settle(Settlement::accept);
  EXPECT_FALSE(link_.due());
  clock_.advance(milliseconds(1));
  EXPECT_FALSE(link_.due());
  clock_.advance(milliseconds(1));
  EXPECT_TRUE(link_.due());
  link_.tell();
  held_[2].settle(Settlement::accept);
  held_[3].settle(Settlement::accept);
  EXPECT_FALSE(link_.due());
  held_[4].settle(Settlement::accept);
  EXPECT_TRUE(link_.due()) << "more than half of the prefetch";
}

TEST_F(ReadCoreTest, TakesWhatCameAsFarAsThereIsRoom) {
  const auto a = reader("a");
  {
    const config::MutexLock lock(link_.core.mutex);
    a->in_server = {"1", "2", "3"};
    a->more = true;
    link_.core.make_ready(*a);
  }
  link_.room = 2;
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 1", "a 2"));
  link_.room = 1;
  {
    const config::MutexLock lock(link_.core.mutex);
    link_.core.make_ready(*a);
  }
  link_.hand_on();
  EXPECT_THAT(seen(), ElementsAre("a 3"));
}

TEST_F(ReadCoreTest, WhatIsWithheldWaits) {
  const auto a = reader("a");
  deliver(*a, {"1"});
  {
    const config::MutexLock lock(link_.core.mutex);
    a->withheld = true;
  }
  EXPECT_EQ(link_.hand_on(), 0);
  {
    const config::MutexLock lock(link_.core.mutex);
    a->withheld = false;
    link_.core.make_ready(*a);
  }
  EXPECT_EQ(link_.hand_on(), 1);
}

TEST_F(ReadCoreTest, AStopWaitsForTheHandlerThatRunsAndHandsOnNothingMore) {
  const auto a = reader("a");
  deliver(*a, {"1", "2"});
  std::atomic<bool> entered = false, ended = false;
  on_message_ = [&] {
    entered = true;
    while (link_.has_ready()) std::this_thread::yield();  // the second one, until the stop
    for (int i = 0; i < 1000; ++i) std::this_thread::yield();
    ended = true;
  };
  std::thread handing_on([&] { link_.hand_on(); });
  while (!entered) std::this_thread::yield();
  link_.stop();
  EXPECT_TRUE(ended);
  handing_on.join();
  EXPECT_EQ(link_.hand_on(), 0);
  EXPECT_THAT(seen(), ElementsAre("a 1"));
}

/// A server that keeps what nobody accepted: after a loss it delivers again from the first of those.
struct ServedTopic {
  explicit ServedTopic(int count) {
    for (int i = 1; i <= count; ++i) kept.push_back(i);
  }
  std::deque<int> kept;
  std::deque<std::optional<int>> under_way;  ///< of this channel, from tag `first` on; none: settled
  std::uint64_t first = 1;
  std::size_t delivered = 0;  ///< so many of kept are under way
};

/// Threads that hand on, settle, pause and read on, while connections break: handlers of a subscription never overlap,
/// what comes for the first time comes in order, and the server is told of each message.
TEST(ReadCoreStress, EveryMessageIsAcceptedOnceAndInOrderOverLossesRetriesAndPauses) {
  constexpr int topics = 3, messages = 300;
  constexpr std::size_t prefetch = 8;
  ReadLink link(config::system_clock());
  config::Mutex mutex;
  std::deque<Delivery> to_settle;
  struct Reading {
    std::shared_ptr<LinkReader> reader;
    ServedTopic served{messages};
    std::atomic<bool> busy = false;
    std::atomic<int> highest = 0;
  };
  std::vector<std::unique_ptr<Reading>> all;
  for (int i = 0; i < topics; ++i) {
    all.push_back(std::make_unique<Reading>());
    Reading& one = *all.back();
    SubscriptionOptions options;
    options.prefetch = prefetch;
    one.reader = std::make_shared<LinkReader>(link, std::to_string(i), options, [&](Delivery delivery) {
      EXPECT_FALSE(one.busy.exchange(true)) << "two handlers of one subscription";
      const int number = std::stoi(std::string(delivery.message.payload.text()));
      EXPECT_LE(number, one.highest + 1);
      one.highest = std::max(number, one.highest.load());
      if (number % 3 == 0) {
        delivery.settle(Settlement::accept);
      } else {
        const config::MutexLock lock(mutex);
        to_settle.push_back(std::move(delivery));
      }
      one.busy = false;
    });
  }
  std::atomic<bool> done = false;
  const auto settling = [&](unsigned seed) {
    std::minstd_rand random(seed);
    while (!done) {
      std::optional<Delivery> delivery;
      {
        const config::MutexLock lock(mutex);
        if (!to_settle.empty()) {
          delivery = std::move(to_settle.front());
          to_settle.pop_front();
        }
      }
      if (delivery) delivery->settle(random() % 8 == 0 ? Settlement::retry : Settlement::accept);
      LinkReader& reader = *all[random() % topics]->reader;
      if (random() % 16 == 0) link.pause(reader);
      if (random() % 4 == 0) link.resume(reader);
      std::this_thread::yield();
    }
  };
  std::vector<std::thread> threads;
  threads.emplace_back(settling, 11U);
  threads.emplace_back(settling, 12U);
  for (int i = 0; i < 2; ++i) {
    threads.emplace_back([&] {
      while (!done) {
        if (link.hand_on(5) == 0) std::this_thread::yield();
      }
    });
  }
  std::minstd_rand random(13);
  const auto serve = [&](Reading& one) {
    const config::MutexLock lock(link.core.mutex);
    ServedTopic& served = one.served;
    for (const AckWindow::Action& action : one.reader->window.take(prefetch / 2)) {
      for (std::uint64_t tag = action.multiple ? served.first : action.tag; tag <= action.tag; ++tag) {
        const std::optional<int> number = std::exchange(served.under_way[tag - served.first], std::nullopt);
        if (!number) continue;
        EXPECT_EQ(std::erase(served.kept, *number), 1U) << "accepted twice";
        --served.delivered;
      }
      for (; !served.under_way.empty() && !served.under_way.front(); ++served.first) served.under_way.pop_front();
    }
    while (served.delivered < std::min(prefetch, served.kept.size())) {
      const int number = served.kept[served.delivered++];
      served.under_way.emplace_back(number);
      Message message;
      message.payload = Payload::copy(std::to_string(number));
      EXPECT_TRUE(link.core.arrived(*one.reader, {std::move(message), false, ++one.reader->last_tag, 0}));
    }
  };
  const auto empty = [&] {
    return std::all_of(all.begin(), all.end(), [](const auto& one) { return one->served.kept.empty(); });
  };
  while (!empty()) {
    for (const auto& one : all) serve(*one);
    if (random() % 200 == 0) {
      for (const auto& one : all) {
        link.lose(*one->reader);
        one->served.under_way.clear();
        one->served.first = 1;
        one->served.delivered = 0;
      }
    }
    std::this_thread::yield();
  }
  for (const auto& one : all) link.remove(*one->reader);
  link.stop();
  done = true;
  for (std::thread& thread : threads) thread.join();
  to_settle.clear();
  for (const auto& one : all) EXPECT_EQ(one->highest, messages);
}

}  // namespace
}  // namespace iotcloud::brokers::client
