// What a worker that stood still has in hand is not sent.
#include <atomic>
#include <functional>
#include <future>
#include <utility>

#include <gmock/gmock.h>

#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>

namespace iotcloud::topology {
namespace {

using std::chrono::milliseconds;
using testing::ElementsAre;

class HandClock final : public config::Clock {
 public:
  Instant now() const override {
    const Instant read = now_;
    if (const auto hook = std::exchange(after_reading_, {})) hook();
    return read;
  }
  std::int64_t wall_ms() const override { return 0; }
  void pass(milliseconds time) { now_ += time; }
  /// Runs once, when the clock was read the next time.
  void after_reading(std::function<void()> hook) { after_reading_ = std::move(hook); }

 private:
  Instant now_{std::chrono::hours(1)};
  mutable std::function<void()> after_reading_;
};

TEST(StandstillFence, StaysDownWhileTheProcessBeats) {
  HandClock clock;
  StandstillFence fence(clock, milliseconds(1000));
  const auto taken = clock.now();
  for (int i = 0; i < 100; ++i) {
    clock.pass(milliseconds(1000));
    fence.beat();
  }
  EXPECT_FALSE(fence.voids(taken));
  EXPECT_EQ(fence.count(), 0u);
}

TEST(StandstillFence, VoidsWhatWasTakenBeforeTheProcessStoodStillAlsoForTheFirstWhoAsks) {
  HandClock clock;
  StandstillFence fence(clock, milliseconds(1000));
  const auto before = clock.now();
  clock.pass(milliseconds(1001));
  EXPECT_TRUE(fence.voids(before)) << "nobody has beaten yet";
  fence.beat();
  EXPECT_TRUE(fence.voids(before));
  EXPECT_FALSE(fence.voids(clock.now())) << "what is taken from now on counts";
  EXPECT_EQ(fence.count(), 1u);
}

TEST(StandstillFence, SeesAStandStillInTheMiddleOfABeat) {
  HandClock clock;
  StandstillFence fence(clock, milliseconds(1000));
  const auto before = clock.now();
  clock.after_reading([&] { clock.pass(milliseconds(1001)); });
  fence.beat();
  EXPECT_TRUE(fence.voids(before));
}

TEST(StandstillFence, CountsBeforeItTakesTheTimeSoThatNothingTakenWithTheOldCountIsNewer) {
  HandClock clock;
  StandstillFence fence(clock, milliseconds(1000));
  std::uint64_t count = 0;
  clock.after_reading([&] { count = fence.count(); });
  fence.raise();
  EXPECT_EQ(count, 1u);
}

TEST(StandstillFence, TellsItsListenersOnceWithTheNextBeat) {
  HandClock clock;
  StandstillFence fence(clock, milliseconds(1000));
  int told = 0;
  const int listener = fence.listen([&] { ++told; });
  fence.beat();
  EXPECT_EQ(told, 0);
  clock.pass(milliseconds(5000));
  EXPECT_EQ(fence.count(), 1u);
  EXPECT_EQ(told, 0);
  fence.beat();
  fence.beat();
  EXPECT_EQ(told, 1);
  fence.raise();
  fence.beat();
  EXPECT_EQ(told, 2);
  fence.ignore(listener);
  fence.raise();
  fence.beat();
  EXPECT_EQ(told, 2);
}

TEST(StandstillFence, NobodyWaitsForAListenerThatRuns) {
  StandstillFence fence;
  std::atomic<bool> inside{false}, open{false};
  int told = 0, later = 0;
  fence.listen([&] {
    ++told;
    inside = true;
    EXPECT_TRUE(eventually([&] { return open.load(); }));
  });
  fence.raise();
  auto beat = std::async(std::launch::async, [&] { fence.beat(); });
  ASSERT_TRUE(eventually([&] { return inside.load(); }));
  auto listening = std::async(std::launch::async, [&] {
    fence.listen([&] { ++later; });
    fence.beat();
  });
  // half as long as the listener waits, so that a test that fails comes to its end
  EXPECT_EQ(listening.wait_for(tests::patience / 2), std::future_status::ready);
  open = true;
  beat.get();
  listening.get();
  EXPECT_EQ(told, 1);
  EXPECT_EQ(later, 0) << "it came after the fence was raised";
}

TEST(StandstillFence, AListenerMayCallTheFence) {
  StandstillFence fence;
  int told = 0, other = 0, self = 0;
  self = fence.listen([&] {
    ++told;
    fence.ignore(self);
    fence.raise();
    fence.beat();  // the beat that runs looks again
  });
  fence.listen([&] { ++other; });
  fence.raise();
  fence.beat();
  EXPECT_EQ(told, 1);
  EXPECT_EQ(other, 2);
}

TEST(StandstillFence, WhoIgnoresAListenerWaitsForItsEnd) {
  StandstillFence fence;
  std::atomic<bool> inside{false}, ended{false};
  const int listener = fence.listen([&] {
    inside = true;
    EXPECT_TRUE(eventually([&] { return fence.count() == 2; }));
    ended = true;
  });
  fence.raise();
  auto beat = std::async(std::launch::async, [&] { fence.beat(); });
  ASSERT_TRUE(eventually([&] { return inside.load(); }));
  auto ignoring = std::async(std::launch::async, [&] {
    fence.ignore(listener);
    return ended.load();
  });
  fence.raise();
  EXPECT_TRUE(ignoring.get());
  beat.get();
}

/// Time that passes by itself; the first who reads it after arm() stands until the test lets him go on.
class StandingClock final : public config::Clock {
 public:
  Instant now() const override {
    if (armed_.exchange(false)) {
      here_ = true;
      EXPECT_TRUE(eventually([&] { return open_.load(); }));
    }
    return config::system_clock().now();
  }
  std::int64_t wall_ms() const override { return 0; }
  void arm() { armed_ = true; }
  bool wait_for_one() const {
    return eventually([&] { return here_.load(); });
  }
  void open() { open_ = true; }

 private:
  mutable std::atomic<bool> armed_{false}, here_{false};
  std::atomic<bool> open_{false};
};

class Fenced : public Endpoints {
 protected:
  Worker& run_fenced(BoltFactory gate = [] { return make_bolt<GateBolt>(); }) {
    ComponentRegistry components;
    components.add_bolt("Gate", std::move(gate));
    WorkerOptions options{
        .definition = TopologyDefinition::parse("topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, "
                                                "channel: up, fields: [text, driverID, time],"
                                                " builder: text}\nbolts:\n  gate: {class: Gate, inputs: {from: in}}\n"
                                                "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, "
                                                "driverID, time], inputs: {from: gate}}\n",
                                                "t.yaml"),
        .components = std::move(components),
        .library_folders = {},
        .registry = registry_.get(),
        .clock = nullptr,
        .metrics = &metrics_,
        .on_killed = {},
        .fence = fence_};
    workers_.push_back(std::make_unique<Worker>(std::move(options)));
    workers_.back()->start();
    return *workers_.back();
  }
  double fenced() const {
    for (const auto& sample : metrics_.collect()) {
      if (sample.name != "iotcloud_bolt_lost_total") continue;
      const auto reason = sample.labels.find("reason");
      if (reason != sample.labels.end() && reason->second == "fenced") return sample.value;
    }
    return 0;
  }
  std::shared_ptr<StandstillFence> fence_ = std::make_shared<StandstillFence>();
};

TEST_F(Fenced, TheBeatDoesNotWaitForAReaderThatIsBeingOpened) {
  StandingClock clock;
  fence_ = std::make_shared<StandstillFence>(clock, std::chrono::hours(1));
  run_fenced();
  Mailbox down(*broker_, topic("i", "down"));
  const auto up = device("i");
  clock.arm();  // a reader asks the fence when it is opened
  show_driver("i");
  ASSERT_TRUE(clock.wait_for_one());
  fence_->raise();
  auto beat = std::async(std::launch::async, [&] { fence_->beat(); });
  // half as long as the reader stands, so that a test that fails comes to its end
  EXPECT_EQ(beat.wait_for(tests::patience / 2), std::future_status::ready);
  clock.open();
  beat.get();
  up->publish(message("1", "i"));
  EXPECT_TRUE(down.wait_for(1));
  workers_.clear();  // before the clock
}

TEST_F(Fenced, WhatWasInHandIsNotSentAndComesAgainFromTheBrokerInOrder) {
  Mailbox down(*broker_, topic("i", "down"));
  const auto up = device("i");
  show_driver("i");
  run_fenced();
  Gate::set(false);
  for (const char* text : {"1", "2", "3"}) up->publish(message(text, "i"));
  {
    std::unique_lock lock(Gate::mutex);
    ASSERT_TRUE(Gate::changed.wait_for(lock, tests::patience, [] { return Gate::inside == 1; }));
  }
  fence_->raise();  // "1" is in the bolt, the others are behind it
  fence_->beat();
  up->publish(message("4", "i"));
  Gate::set(true);
  ASSERT_TRUE(down.wait_for(4));
  EXPECT_TRUE(eventually([&] { return fenced() >= 1; }));
  EXPECT_THAT(down.texts(), ElementsAre("1", "2", "3", "4"));
  EXPECT_GE(Gate::inside, 5) << "the first one was worked on twice";
}

/// Says of each tuple that has passed the gate whether it is void, and acks it if it is not.
class AskingBolt final : public Bolt {
 public:
  explicit AskingBolt(std::shared_ptr<std::vector<std::string>> answers) : answers_(std::move(answers)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void execute(const Tuple& tuple) override {
    std::unique_lock lock(Gate::mutex);
    ++Gate::inside;
    Gate::changed.notify_all();
    Gate::changed.wait(lock, [] { return Gate::open; });
    const bool is_void = collector_->is_void(tuple);
    answers_->push_back(tuple.get<std::string>("text") + (is_void ? " is void" : " counts"));
    is_void ? collector_->retry(tuple) : collector_->ack(tuple);
  }

 private:
  const std::shared_ptr<std::vector<std::string>> answers_;  ///< guarded by Gate::mutex
  OutputCollector* collector_ = nullptr;
};

TEST_F(Fenced, ABoltIsToldThatATupleIsVoidAndItsMessageComesAgain) {
  const auto answers = std::make_shared<std::vector<std::string>>();
  const auto up = device("i");
  show_driver("i");
  run_fenced([answers] { return std::make_unique<AskingBolt>(answers); });
  Gate::set(false);
  up->publish(message("1", "i"));
  ASSERT_TRUE(Gate::wait_for_one());
  fence_->raise();
  Gate::set(true);
  const auto said = [&] {
    const std::lock_guard lock(Gate::mutex);
    return *answers;
  };
  ASSERT_TRUE(eventually([&] { return !said().empty(); }));
  fence_->beat();
  EXPECT_TRUE(eventually([&] { return said().size() == 2; }));
  EXPECT_THAT(said(), ElementsAre("1 is void", "1 counts"));
}

TEST_F(Fenced, WhatAPublisherHasNotSentYetIsDropped) {
  brokers::PublisherOptions options;
  std::atomic<int> dropped{0};
  std::string why;
  options.void_before = [this] { return fence_->since(); };
  options.on_outcome = [&](std::uint64_t, brokers::Outcome outcome, const std::string& reason) {
    if (outcome != brokers::Outcome::dropped) return;
    why = reason;
    ++dropped;
  };
  const auto publisher = broker_->publisher({"", "nobody.reads", false}, options);
  publisher->publish(message("stale", "i"));
  fence_->raise();
  publisher->publish(message("fresh", "i"));
  Mailbox reader(*broker_, "nobody.reads");
  ASSERT_TRUE(reader.wait_for(1));
  ASSERT_TRUE(eventually([&] { return dropped == 1; }));
  EXPECT_EQ(why, "fenced");
  EXPECT_THAT(reader.texts(), ElementsAre("fresh"));
}

}  // namespace
}  // namespace iotcloud::topology
