// The life of a connection without a server: the test decides what each attempt and each use of it does, and moves the
// clock.
#include "iotcloud/brokers/rabbitmq/connection_life.h"

#include <algorithm>
#include <functional>
#include <mutex>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/config/hand_clock.h"
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using tests::eventually;

/// Sleeps by a clock that the test moves.
class HandSleep final : public ConnectionSleep {
 public:
  explicit HandSleep(const config::Clock& clock) : clock_(clock) {}
  void signal() noexcept override {
    {
      const config::MutexLock lock(mutex_);
      signalled_ = true;
    }
    changed_.notify_all();
  }
  void watch(int /*socket*/, bool /*want_write*/) override {}
  Result wait(std::chrono::milliseconds limit) override {
    const config::MutexLock lock(mutex_);
    const auto end = clock_.now() + limit;
    while (!signalled_) {
      if (changed_.wait_until(mutex_, clock_, end) == std::cv_status::timeout) break;
    }
    signalled_ = false;
    return {};
  }

 private:
  const config::Clock& clock_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  bool signalled_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

class RabbitMqConnectionLife : public testing::Test, protected ConnectionLife::Owner {
 protected:
  explicit RabbitMqConnectionLife(const std::vector<std::string>& servers = {"amqp://one"})
      : cluster_(options_of(servers), urls_of(servers)),
        life_("test-life", *this, mutex_, sleep_, cluster_, clock_, log_) {}
  ~RabbitMqConnectionLife() override = default;
  void TearDown() override { end(); }  // not in the destructor: the thread calls this object by its virtual functions

  void start() {
    const config::MutexLock lock(mutex_);
    life_.start();
  }
  void end() {
    bool mine = false;
    {
      const config::MutexLock lock(mutex_);
      mine = life_.begin_to_end();
    }
    if (mine) life_.join();
  }
  /// As a thread does that finds the connection broken.
  void find_broken() {
    const config::MutexLock lock(mutex_);
    try {
      throw LinkError("reset by peer");
    } catch (...) {
      life_.broke();
    }
  }
  void wake() {
    const config::MutexLock lock(mutex_);
    life_.wake();
  }
  bool moving() {
    const config::MutexLock lock(mutex_);
    return life_.moving();
  }
  bool life_ending() {
    const config::MutexLock lock(mutex_);
    return life_.ending();
  }
  void set_idle(bool idle) {
    const config::MutexLock lock(mutex_);
    idle_ = idle;
  }
  /// Waits until the thread waits for the clock.
  bool sleeps() {
    return eventually([&] { return clock_.waiting() == 1; });
  }
  /// What has happened since the last call. Serving and calling back, which may happen any number of times, are not in
  /// it.
  std::vector<std::string> take_events() {
    const std::lock_guard lock(events_mutex_);
    return std::exchange(events_, {});
  }
  bool happened(const std::string& event) {
    return eventually([&] {
      const std::lock_guard lock(events_mutex_);
      return std::find(events_.begin(), events_.end(), event) != events_.end();
    });
  }
  int served() {
    const config::MutexLock lock(mutex_);
    return served_;
  }

  // What the test wants to happen at these moments: without the mutex, on the life's thread.
  std::function<void(std::size_t server)> in_open = [](std::size_t) {};
  std::function<void()> in_serve = [] {};
  std::function<void()> in_finish = [] {};
  std::function<void()> in_forget = [] {};  ///< as while another thread has the wire

  tests::HandClock clock_;

 private:
  static BrokerOptions options_of(const std::vector<std::string>& servers) {
    BrokerOptions options;
    options.urls = servers;
    return options;
  }
  static std::vector<BrokerUrl> urls_of(const std::vector<std::string>& servers) {
    std::vector<BrokerUrl> urls;
    urls.reserve(servers.size());
    for (const std::string& server : servers) urls.push_back(parse_broker_url(server));
    return urls;
  }
  void note(const std::string& event) {
    const std::lock_guard lock(events_mutex_);
    events_.push_back(event);
  }

  void open(std::size_t server) override {
    note("open " + std::to_string(server));
    in_open(server);
  }
  std::shared_ptr<ShownChain> opened() override {
    note("opened");
    return nullptr;
  }
  void serve(ConnectionLife::Readiness /*ready*/) override {
    mutex_.assert_held();
    ++served_;
    const config::Unlocked unlocked(mutex_);
    in_serve();
  }
  void call_back() override {}
  ConnectionLife::Rest rest() override {
    ConnectionLife::Rest rest;
    rest.limit = std::chrono::hours(1);
    return rest;
  }
  bool idle() const override {
    mutex_.assert_held();
    return idle_;
  }
  void finish() override {
    note("finish");
    mutex_.assert_held();
    const config::Unlocked unlocked(mutex_);
    in_finish();
  }
  void forget() override {
    mutex_.assert_held();
    {
      const config::Unlocked unlocked(mutex_);
      in_forget();
    }
    note("forget");
  }
  void close(bool in_order) noexcept override { note(in_order ? "close" : "drop"); }

  mutable config::Mutex mutex_;
  std::mutex events_mutex_;
  std::vector<std::string> events_;  ///< guarded by events_mutex_
  int served_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  bool idle_ IOTCLOUD_GUARDED_BY(mutex_) = true;
  const Cluster cluster_;
  ConnectionLog log_{"amqp://one"};
  HandSleep sleep_{clock_};

 protected:
  ConnectionLife life_;
};

TEST_F(RabbitMqConnectionLife, ItOpensServesAndClosesInOrder) {
  start();
  ASSERT_TRUE(sleeps());
  EXPECT_EQ(served(), 1);
  end();
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened", "finish", "forget", "close"));
}

TEST_F(RabbitMqConnectionLife, AWakeHasItServeOnceMore) {
  start();
  ASSERT_TRUE(sleeps());
  wake();
  EXPECT_TRUE(eventually([&] { return served() == 2; }));
}

TEST_F(RabbitMqConnectionLife, AStartOfARunningLifeWakesIt) {
  start();
  ASSERT_TRUE(sleeps());
  start();
  EXPECT_TRUE(eventually([&] { return served() == 2; }));
}

TEST_F(RabbitMqConnectionLife, AfterAFailureItWaitsByTheInjectedClock) {
  in_open = [](std::size_t) { throw LinkError("nobody listens"); };
  start();
  ASSERT_TRUE(sleeps());
  clock_.advance(24ms);  // the first pause is 25 to 50 ms
  ASSERT_TRUE(sleeps());
  EXPECT_THAT(take_events(), ElementsAre("open 0"));
  clock_.advance(26ms);
  EXPECT_TRUE(happened("open 0"));
}

TEST_F(RabbitMqConnectionLife, MemoryThatRunsOutWhileItConnectsIsAFailureLikeOthers) {
  in_open = [](std::size_t) { throw std::bad_alloc(); };
  start();
  ASSERT_TRUE(sleeps()) << "it does not try again and again without a pause";
  EXPECT_THAT(take_events(), ElementsAre("open 0"));
  in_open = [](std::size_t) {};
  clock_.advance(50ms);
  EXPECT_TRUE(happened("opened"));
}

TEST_F(RabbitMqConnectionLife, ItsEndDoesNotWaitForAPause) {
  in_open = [](std::size_t) { throw LinkError("nobody listens"); };
  start();
  ASSERT_TRUE(sleeps());
  end();
  EXPECT_THAT(take_events(), ElementsAre("open 0")) << "nothing is open, so nothing is closed";
}

TEST_F(RabbitMqConnectionLife, AConnectionThatOpensWhileTheLifeEndsIsClosedInOrderAndNeverServed) {
  std::jthread ending;
  in_open = [&](std::size_t) {
    ending = std::jthread([&] { end(); });
    ASSERT_TRUE(eventually([&] { return life_ending(); }));
  };
  start();
  ASSERT_TRUE(happened("close"));
  ending.join();
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened", "finish", "forget", "close"));
  EXPECT_EQ(served(), 0);
}

TEST_F(RabbitMqConnectionLife, AConnectionThatAnotherThreadFindsBrokenIsDroppedAndAnotherOpensAfterAPause) {
  start();
  ASSERT_TRUE(sleeps());
  find_broken();
  ASSERT_TRUE(happened("drop"));
  ASSERT_TRUE(sleeps());
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened", "forget", "drop"));
  clock_.advance(50ms);
  ASSERT_TRUE(happened("opened"));
}

TEST_F(RabbitMqConnectionLife, WhatIsFoundBrokenTwiceIsDroppedOnce) {
  start();
  ASSERT_TRUE(sleeps());
  // The thread that still has the wire finds it broken, too, while the life waits for the wire.
  in_forget = [this] { find_broken(); };
  find_broken();
  ASSERT_TRUE(happened("drop"));
  take_events();
  ASSERT_TRUE(sleeps());
  clock_.advance(50ms);
  ASSERT_TRUE(happened("opened"));
  ASSERT_TRUE(sleeps());
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened")) << "the next connection is not the broken one";
}

TEST_F(RabbitMqConnectionLife, AnErrorWhileItServesEndsTheConnectionOnly) {
  in_serve = [] { throw LinkError("the server closed it"); };
  start();
  ASSERT_TRUE(happened("drop"));
  ASSERT_TRUE(sleeps());
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened", "forget", "drop"));
  in_serve = [] {};
  clock_.advance(50ms);
  EXPECT_TRUE(happened("opened"));
}

TEST_F(RabbitMqConnectionLife, AConnectionThatBreaksWhileItIsClosedIsDropped) {
  in_finish = [] { throw LinkError("reset by peer"); };
  start();
  ASSERT_TRUE(sleeps());
  end();
  EXPECT_THAT(take_events(), ElementsAre("open 0", "opened", "finish", "forget", "drop"));
}

TEST_F(RabbitMqConnectionLife, OnlyOneCallerEndsItAndThenItDoesNotStart) {
  start();
  ASSERT_TRUE(sleeps());
  end();
  end();
  start();
  EXPECT_TRUE(take_events().size() == 5);
}

TEST_F(RabbitMqConnectionLife, ALifeThatEndsBeforeItStartsNeverOpens) {
  end();
  start();
  EXPECT_TRUE(take_events().empty());
}

/// A life that is on the second server, because the first one was away.
class RabbitMqConnectionLifeOfTwo : public RabbitMqConnectionLife {
 protected:
  RabbitMqConnectionLifeOfTwo() : RabbitMqConnectionLife({"amqp://one", "amqp://two"}) {}
  void SetUp() override {
    in_open = [&](std::size_t server) {
      if (server == 0) throw LinkError("nobody listens");
    };
    start();
    ASSERT_TRUE(sleeps());
    ASSERT_THAT(take_events(), ElementsAre("open 0", "open 1", "opened")) << "without a pause";
    in_open = [](std::size_t) {};
  }
  /// The preferred server answers, for as long as makes the life move back.
  void first_answers() {
    EXPECT_FALSE(life_.must_ask_preferred());
    clock_.advance(1s);
    EXPECT_TRUE(life_.must_ask_preferred());
    life_.preferred_answered(true);
    clock_.advance(7500ms);
    EXPECT_TRUE(eventually([&] { return life_.must_ask_preferred(); }));
    life_.preferred_answered(true);
  }
};

TEST_F(RabbitMqConnectionLifeOfTwo, ItMovesBackWhenThePreferredServerHasAnsweredForAWhile) {
  first_answers();
  ASSERT_TRUE(happened("opened"));
  EXPECT_THAT(take_events(), ElementsAre("finish", "forget", "close", "open 0", "opened"));
  EXPECT_FALSE(life_.must_ask_preferred());
}

TEST_F(RabbitMqConnectionLifeOfTwo, BeforeItMovesItWaitsForAnswersUntilThatTakesTooLong) {
  set_idle(false);
  first_answers();
  ASSERT_TRUE(eventually([&] { return moving(); }));
  ASSERT_TRUE(sleeps());
  EXPECT_TRUE(take_events().empty());
  clock_.advance(ConnectionLife::moving_patience);
  ASSERT_TRUE(happened("opened"));
  EXPECT_THAT(take_events(), ElementsAre("finish", "forget", "close", "open 0", "opened"));
  EXPECT_FALSE(moving());
}

TEST_F(RabbitMqConnectionLifeOfTwo, ItMovesAsSoonAsEverythingIsAnswered) {
  set_idle(false);
  first_answers();
  ASSERT_TRUE(eventually([&] { return moving(); }));
  ASSERT_TRUE(sleeps());
  set_idle(true);
  clock_.advance(ConnectionLife::moving_period);
  EXPECT_TRUE(happened("opened"));
}

TEST_F(RabbitMqConnectionLifeOfTwo, AConnectionThatBreaksWhileItMovesIsDroppedAndAnotherOpens) {
  set_idle(false);
  first_answers();
  ASSERT_TRUE(eventually([&] { return moving(); }));
  ASSERT_TRUE(sleeps());
  find_broken();
  ASSERT_TRUE(happened("opened"));
  EXPECT_THAT(take_events(), ElementsAre("forget", "drop", "open 0", "opened")) << "the preferred one is due";
  EXPECT_FALSE(moving()) << "the new connection may be used at once";
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
