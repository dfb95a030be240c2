// What a worker that stood still has in hand is not sent.
#include <functional>
#include <utility>

#include <gmock/gmock.h>

#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/fence.h>

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

TEST(Fence, StaysDownWhileTheProcessBeats) {
  HandClock clock;
  Fence fence(clock, milliseconds(1000));
  const auto taken = clock.now();
  for (int i = 0; i < 100; ++i) {
    clock.pass(milliseconds(1000));
    fence.beat();
  }
  EXPECT_FALSE(fence.voids(taken));
  EXPECT_EQ(fence.count(), 0u);
}

TEST(Fence, VoidsWhatWasTakenBeforeTheProcessStoodStillAlsoForTheFirstWhoAsks) {
  HandClock clock;
  Fence fence(clock, milliseconds(1000));
  const auto before = clock.now();
  clock.pass(milliseconds(1001));
  EXPECT_TRUE(fence.voids(before)) << "nobody has beaten yet";
  fence.beat();
  EXPECT_TRUE(fence.voids(before));
  EXPECT_FALSE(fence.voids(clock.now())) << "what is taken from now on counts";
  EXPECT_EQ(fence.count(), 1u);
}

TEST(Fence, SeesAStandStillInTheMiddleOfABeat) {
  HandClock clock;
  Fence fence(clock, milliseconds(1000));
  const auto before = clock.now();
  clock.after_reading([&] { clock.pass(milliseconds(1001)); });
  fence.beat();
  EXPECT_TRUE(fence.voids(before));
}

TEST(Fence, CountsBeforeItTakesTheTimeSoThatNothingTakenWithTheOldCountIsNewer) {
  HandClock clock;
  Fence fence(clock, milliseconds(1000));
  std::uint64_t count = 0;
  clock.after_reading([&] { count = fence.count(); });
  fence.put_up();
  EXPECT_EQ(count, 1u);
}

TEST(Fence, TellsItsListenersOnceWithTheNextBeat) {
  HandClock clock;
  Fence fence(clock, milliseconds(1000));
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
  fence.put_up();
  fence.beat();
  EXPECT_EQ(told, 2);
  fence.ignore(listener);
  fence.put_up();
  fence.beat();
  EXPECT_EQ(told, 2);
}

class Fenced : public Endpoints {
 protected:
  Worker& run_fenced() {
    ComponentRegistry components;
    components.add_bolt<GateBolt>("Gate");
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
  const std::shared_ptr<Fence> fence_ = std::make_shared<Fence>();
};

TEST_F(Fenced, WhatWasInHandIsNotSentAndComesAgainFromTheBrokerInOrder) {
  Mailbox down(*broker_, topic("i", "down"));
  const auto up = device("i");
  show_driver("i");
  run_fenced();
  Gate::set(false);
  for (const char* text : {"1", "2", "3"}) up->publish(message(text, "i"));
  {
    std::unique_lock lock(Gate::mutex);
    ASSERT_TRUE(Gate::changed.wait_for(lock, std::chrono::seconds(20), [] { return Gate::inside == 1; }));
  }
  fence_->put_up();  // "1" is in the bolt, the others are behind it
  fence_->beat();
  up->publish(message("4", "i"));
  Gate::set(true);
  ASSERT_TRUE(down.wait_for(4));
  EXPECT_TRUE(eventually([&] { return fenced() >= 1; }));
  EXPECT_THAT(down.texts(), ElementsAre("1", "2", "3", "4"));
  EXPECT_GE(Gate::inside, 5) << "the first one was worked on twice";
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
  fence_->put_up();
  publisher->publish(message("fresh", "i"));
  Mailbox reader(*broker_, "nobody.reads");
  ASSERT_TRUE(reader.wait_for(1));
  ASSERT_TRUE(eventually([&] { return dropped == 1; }));
  EXPECT_EQ(why, "fenced");
  EXPECT_THAT(reader.texts(), ElementsAre("fresh"));
}

}  // namespace
}  // namespace iotcloud::topology
