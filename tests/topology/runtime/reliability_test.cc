#include <algorithm>
#include <random>
#include <stdexcept>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

/// A source, a bolt that keeps what it gets, and simulated time.
class Reliability : public testing::Test {
 protected:
  void start(const std::function<void(TopologyBuilder&)>& add, RuntimeOptions options) {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(source));
    add(builder);
    runtime = std::make_unique<Runtime>(builder.build("reliability"), std::move(options));
    runtime->start();
    runtime->run_until_idle();
  }
  BoltFactory keeper(const Fields& fields = {}) {
    return bolt(
        [this](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
          collectors.push_back(&out);
          kept.push_back(tuple);
        },
        fields);
  }
  /// Emits a tuple for each two that it gets, anchored to both.
  static BoltFactory join_of_two() {
    return bolt(
        [held = std::make_shared<std::vector<Tuple>>()](const Tuple& tuple, OutputCollector& out,
                                                        const TopologyContext&) {
          held->push_back(tuple);
          if (held->size() < 2) return;
          out.emit(*held, Values(1));
          for (const Tuple& anchor : *held) out.ack(anchor);
          held->clear();
        },
        {"sum"});
  }
  void pass(std::chrono::nanoseconds time) {
    bench.clock.advance(time);
    runtime->run_due_timers();
    runtime->run_until_idle();
  }
  void settle(std::size_t which, bool ack) {
    ack ? collectors.at(which)->ack(kept.at(which)) : collectors.at(which)->fail(kept.at(which));
    runtime->run_until_idle();
  }

  Bench bench;
  std::shared_ptr<Source> source = std::make_shared<Source>();
  std::unique_ptr<Runtime> runtime;
  std::vector<OutputCollector*> collectors;
  std::vector<Tuple> kept;
  void TearDown() override {
    kept.clear();
    runtime.reset();
  }
};

TEST_F(Reliability, ASpoutThatHadNothingMoreIsAskedAfterAFailureAndNotAfterAnAck) {
  /// Emits one tuple in each call, and then has nothing more.
  class OneByOne final : public Spout {
   public:
    explicit OneByOne(SpoutWaker& waker) : waker_(waker) {}
    void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"value"}); }
    void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
      waker_ = context.waker;
      collector_ = &collector;
    }
    bool next_tuple() override {
      collector_->emit(Values(1), ++calls_);
      return false;
    }

   private:
    SpoutWaker& waker_;
    SpoutOutputCollector* collector_ = nullptr;
    MessageId calls_ = 0;
  };
  SpoutWaker waker;
  start(
      [&](TopologyBuilder& builder) {
        builder.set_spout("one", [&] { return std::make_unique<OneByOne>(waker); });
        builder.set_bolt("keep", keeper()).shuffle_grouping("one");
      },
      bench.options());
  ASSERT_EQ(kept.size(), 1U);
  settle(0, true);
  EXPECT_EQ(kept.size(), 1U) << "it was asked after an ack";
  waker.wake();
  ASSERT_EQ(kept.size(), 2U);
  settle(1, false);
  EXPECT_EQ(kept.size(), 3U) << "it was not asked after a failure";
}

TEST_F(Reliability, AcksOnlyWhenTheWholeTreeIsDone) {
  start(
      [this](TopologyBuilder& builder) {
        builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
        builder.set_bolt("keep", keeper(), 2).all_grouping("pass");
      },
      bench.options());
  source->put(Values(1));
  ASSERT_EQ(kept.size(), 2U);
  EXPECT_THAT(source->acked(), IsEmpty());
  settle(0, true);
  EXPECT_THAT(source->acked(), IsEmpty());
  settle(1, true);
  EXPECT_THAT(source->acked(), ElementsAre(1));
}

TEST_F(Reliability, ATupleThatIsAnsweredAfterItsChildrenHoldsTheTreeUntilThen) {
  for (const bool ack : {true, false}) {
    kept.clear(), collectors.clear();
    source = std::make_shared<Source>();
    start(
        [this](TopologyBuilder& builder) {
          builder
              .set_bolt("parent", bolt(
                                      [this](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                        for (int child = 0; child < 3; ++child) out.emit(tuple, Values(child));
                                        collectors.push_back(&out);
                                        kept.push_back(tuple);
                                      },
                                      {"value"}))
              .shuffle_grouping("in");
          builder.set_bolt("pass", pass_bolt()).shuffle_grouping("parent");
          builder
              .set_bolt("end",
                        bolt([](const Tuple& tuple, OutputCollector& out, const TopologyContext&) { out.ack(tuple); }))
              .shuffle_grouping("pass");
        },
        bench.options());
    source->put(Values(1));
    ASSERT_EQ(kept.size(), 1U);
    EXPECT_EQ(runtime->snapshot().component("end").acked, 3U);
    EXPECT_THAT(source->acked(), IsEmpty());
    settle(0, ack);
    EXPECT_THAT(ack ? source->acked() : source->failed(), ElementsAre(1));
    EXPECT_THAT(ack ? source->failed() : source->acked(), IsEmpty());
    EXPECT_EQ(runtime->snapshot().component("in").pending, 0U);
  }
}

TEST_F(Reliability, ATupleThatIsAckedLaterLeavesTheTreeToTheChildrenThatAreNotSettled) {
  Tuple parent;
  OutputCollector* of_parent = nullptr;
  start(
      [&](TopologyBuilder& builder) {
        builder
            .set_bolt("parent", bolt(
                                    [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                      for (int child = 0; child < 2; ++child) out.emit(tuple, Values(child));
                                      of_parent = &out;
                                      parent = tuple;
                                    },
                                    {"value"}))
            .shuffle_grouping("in");
        builder.set_bolt("keep", keeper()).shuffle_grouping("parent");
      },
      bench.options());
  for (const std::size_t last : {0U, 1U}) {
    const std::size_t first = kept.size();
    source->put(Values(1));
    ASSERT_EQ(kept.size(), first + 2);
    settle(first + 1 - last, true);
    of_parent->ack(parent);
    runtime->run_until_idle();
    EXPECT_EQ(source->acked().size(), last) << "one child is not settled";
    settle(first + last, true);
    EXPECT_EQ(source->acked().size(), last + 1);
  }
  parent = Tuple();
}

TEST_F(Reliability, ATupleThatIsAckedWithItsChildrenLeavesTheTreeToAllOfThem) {
  constexpr int most = 3;
  start(
      [this](TopologyBuilder& builder) {
        builder
            .set_bolt("parent", bolt(
                                    [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                      for (int child = 0; child < tuple.get<std::int64_t>(0); ++child)
                                        out.emit(tuple, Values(child));
                                      out.ack(tuple);
                                    },
                                    {"value"}))
            .shuffle_grouping("in");
        builder.set_bolt("pass", pass_bolt()).shuffle_grouping("parent");
        builder.set_bolt("keep", keeper()).shuffle_grouping("pass");
      },
      bench.options());
  std::vector<MessageId> acked;
  for (int children = 0; children <= most; ++children) {
    // Each of them in turn is the last one.
    for (int last = 0; last < std::max(children, 1); ++last) {
      const std::size_t first = kept.size();
      source->put(Values(children));
      ASSERT_EQ(kept.size(), first + static_cast<std::size_t>(children));
      for (int child = 0; child < children; ++child) {
        EXPECT_EQ(source->acked(), acked);
        settle(first + static_cast<std::size_t>((last + 1 + child) % children), true);
      }
      acked.push_back(acked.size() + 1);
      EXPECT_EQ(source->acked(), acked);
    }
  }
  EXPECT_THAT(source->failed(), IsEmpty());
}

TEST_F(Reliability, ABoltThatThrowsOrFailsAfterItEmittedFailsTheTreeOnceAndItsChildrenSettleIt) {
  const auto origin = std::make_shared<Reader>();
  start(
      [this](TopologyBuilder& builder) {
        builder
            .set_bolt("parent", bolt(
                                    [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                      out.emit(tuple, Values(1));
                                      out.emit(tuple, Values(2));
                                      if (tuple.get<std::int64_t>(0) == 1) throw std::runtime_error("after it emitted");
                                      out.fail(tuple);
                                    },
                                    {"value"}))
            .shuffle_grouping("in");
        builder.set_bolt("keep", keeper()).shuffle_grouping("parent");
      },
      bench.options());
  source->come_from(origin);
  source->put(Values(1));
  source->put(Values(2));
  source->come_from(nullptr);
  ASSERT_EQ(kept.size(), 4U);
  EXPECT_THAT(source->failed(), ElementsAre(1, 2));
  EXPECT_EQ(origin.use_count(), 3) << "both trees, as tuples of theirs are still there";
  for (const std::size_t which : {1U, 3U}) settle(which, true);
  EXPECT_EQ(origin.use_count(), 3) << "the first child of each is not settled";
  for (const std::size_t which : {0U, 2U}) settle(which, true);
  EXPECT_EQ(origin.use_count(), 1);
  EXPECT_THAT(source->failed(), ElementsAre(1, 2));
  EXPECT_THAT(source->acked(), IsEmpty());
}

TEST_F(Reliability, ATupleIsVoidOnceAnyMessageFromWhichItComesComesAgain) {
  const auto first = std::make_shared<Reader>(), second = std::make_shared<Reader>();
  start(
      [this](TopologyBuilder& builder) {
        builder.set_bolt("join", join_of_two()).shuffle_grouping("in");
        builder.set_bolt("keep", keeper()).shuffle_grouping("join");
      },
      bench.options());
  source->come_from(first);
  source->put(Values(1));
  source->come_from(second);
  source->put(Values(2));
  ASSERT_EQ(kept.size(), 1U);
  EXPECT_FALSE(collectors[0]->is_void(kept[0]));
  second->gone = true;
  EXPECT_TRUE(collectors[0]->is_void(kept[0]));
  settle(0, true);
  EXPECT_FALSE(collectors[0]->is_void(kept[0])) << "it is settled";
  EXPECT_EQ(first.use_count(), 1) << "its tree is done";
}

TEST_F(Reliability, ATreeThatFailedOnlyByRetryIsNotBlamedOnItsMessage) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper(), 2).all_grouping("in"); },
        bench.options());
  source->put(Values(1));
  collectors.at(0)->retry(kept.at(0));
  collectors.at(1)->retry(kept.at(1));
  runtime->run_until_idle();
  EXPECT_THAT(source->failed(), ElementsAre(1));
  EXPECT_THAT(source->retried(), ElementsAre(1));
  source->put(Values(2));
  settle(2, false);
  collectors.at(3)->retry(kept.at(3));
  runtime->run_until_idle();
  source->put(Values(3));
  pass(40s);
  EXPECT_THAT(source->failed(), ElementsAre(1, 2, 3));
  EXPECT_THAT(source->retried(), ElementsAre(1)) << "a bolt failed the second, and the third timed out";
}

TEST_F(Reliability, AFailureReachesTheSpoutAtOnceAndOnce) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper(), 2).all_grouping("in"); },
        bench.options());
  source->put(Values(1));
  settle(0, false);
  EXPECT_THAT(source->failed(), ElementsAre(1));
  settle(1, false);
  EXPECT_THAT(source->failed(), ElementsAre(1));
  EXPECT_THAT(source->acked(), IsEmpty());
  EXPECT_EQ(runtime->snapshot().component("in").pending, 0U);
}

TEST_F(Reliability, ATupleWithTwoAnchorsFailsBothTrees) {
  start(
      [this](TopologyBuilder& builder) {
        builder.set_bolt("join", join_of_two()).global_grouping("in");
        builder.set_bolt("keep", keeper()).shuffle_grouping("join");
      },
      bench.options());
  for (int i = 1; i <= 4; ++i) source->put(Values(i));
  ASSERT_EQ(kept.size(), 2U);
  EXPECT_THAT(source->acked(), IsEmpty());
  settle(0, false);
  EXPECT_THAT(source->failed(), UnorderedElementsAre(1, 2));
  settle(1, true);
  EXPECT_THAT(source->acked(), UnorderedElementsAre(3, 4));
}

TEST_F(Reliability, AnchorsOfTheSameTreeCountOnce) {
  start(
      [this](TopologyBuilder& builder) {
        builder.set_bolt("pass", pass_bolt(), 2).all_grouping("in");
        builder.set_bolt("join", join_of_two()).global_grouping("pass");
        builder.set_bolt("keep", keeper()).shuffle_grouping("join");
      },
      bench.options());
  source->put(Values(1));
  ASSERT_EQ(kept.size(), 1U);
  EXPECT_THAT(source->acked(), IsEmpty());
  settle(0, true);
  EXPECT_THAT(source->acked(), ElementsAre(1));
}

TEST_F(Reliability, WhatIsNotAnchoredDoesNotHoldTheTree) {
  start(
      [this](TopologyBuilder& builder) {
        builder
            .set_bolt("loose", bolt(
                                   [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                     out.emit(Values(1));
                                     out.ack(tuple);
                                   },
                                   {"value"}))
            .shuffle_grouping("in");
        builder.set_bolt("keep", keeper()).shuffle_grouping("loose");
      },
      bench.options());
  source->put(Values(1));
  ASSERT_EQ(kept.size(), 1U);
  EXPECT_THAT(source->acked(), ElementsAre(1));
  settle(0, false);
  EXPECT_THAT(source->failed(), IsEmpty());
}

TEST_F(Reliability, FailsByTimeBetweenTheTimeoutAndAnEighthMore) {
  auto options = bench.options();
  options.message_timeout = 800ms;
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); }, options);
  source->put(Values(1));
  pass(50ms);
  source->put(Values(2));
  pass(749ms);
  EXPECT_THAT(source->failed(), IsEmpty());  // 799 ms after the first
  pass(101ms);
  EXPECT_THAT(source->failed(), testing::Contains(1));  // 900 ms
  pass(50ms);
  EXPECT_THAT(source->failed(), ElementsAre(1, 2));
  EXPECT_EQ(runtime->snapshot().component("in").timed_out, 2U);
  settle(0, true);  // late: ignored
  EXPECT_THAT(source->acked(), IsEmpty());
  EXPECT_EQ(runtime->snapshot().component("in").pending, 0U);
}

TEST_F(Reliability, TimesEveryTupleOutWithinItsBoundsWhateverTheMoment) {
  auto options = bench.options();
  options.message_timeout = 800ms;
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); }, options);
  std::map<MessageId, int> put_at, failed_at;
  std::mt19937 random(7);
  MessageId id = 0;
  for (int now = 0; now < 5000; now += 7) {
    if (now < 3500 && random() % 3 == 0) {
      put_at[++id] = now;
      source->put(Values(now));
    }
    pass(7ms);
    for (const MessageId failed : source->failed()) failed_at.emplace(failed, now + 7);
  }
  ASSERT_EQ(failed_at.size(), put_at.size());
  for (const auto& [failed, at] : failed_at) {
    EXPECT_GE(at - put_at[failed], 800) << failed;
    EXPECT_LE(at - put_at[failed], 900 + 7) << failed;
  }
}

TEST_F(Reliability, ResetTimeoutStartsTheTimeAgain) {
  auto options = bench.options();
  options.message_timeout = 800ms;
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); }, options);
  source->put(Values(1));
  pass(700ms);
  collectors.at(0)->reset_timeout(kept.at(0));
  runtime->run_until_idle();
  pass(790ms);
  EXPECT_THAT(source->failed(), IsEmpty());
  pass(220ms);  // the reset, T and two slots
  EXPECT_THAT(source->failed(), ElementsAre(1));
}

TEST_F(Reliability, ATupleDroppedWithoutAckFailsByTimeAndDoesNotHoldUpAStop) {
  auto options = bench.options();
  options.message_timeout = 800ms;
  start(
      [](TopologyBuilder& builder) {
        builder.set_bolt("forgets", bolt([](const Tuple&, OutputCollector&, const TopologyContext&) {}))
            .shuffle_grouping("in");
      },
      options);
  source->put(Values(1));
  pass(790ms);
  EXPECT_THAT(source->failed(), IsEmpty());
  pass(120ms);
  EXPECT_THAT(source->failed(), ElementsAre(1));
  source->put(Values(2));
  EXPECT_TRUE(runtime->stop(0ms));
}

TEST_F(Reliability, ATreeWhoseEndIsKnownIsForgottenWhenItsLastTupleIsSettled) {
  const auto origin = std::make_shared<Reader>();
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper(), 2).all_grouping("in"); },
        bench.options());
  source->come_from(origin);
  source->put(Values(1));
  pass(40s);
  source->put(Values(2));
  settle(2, false);
  ASSERT_THAT(source->failed(), ElementsAre(1, 2));
  source->come_from(nullptr);
  EXPECT_EQ(origin.use_count(), 3) << "both trees, as tuples of theirs are still there";
  for (const std::size_t which : {0U, 1U, 3U}) settle(which, true);
  EXPECT_EQ(origin.use_count(), 1);
  EXPECT_THAT(source->acked(), IsEmpty());
  EXPECT_EQ(runtime->snapshot().component("in").failed, 2U);
}

TEST_F(Reliability, ATupleThatIsDroppedInACallOfAnotherTopologyIsLostInItsOwn) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); },
        bench.options());
  source->put(Values(1));
  ASSERT_EQ(kept.size(), 1U);
  auto elsewhere = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(elsewhere));
  builder
      .set_bolt("drops", bolt([this](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  kept.clear();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  Runtime other(builder.build("other"), bench.options());
  other.start();
  elsewhere->put(Values(1));
  other.run_until_idle();
  EXPECT_THAT(elsewhere->acked(), ElementsAre(1));
  runtime->run_until_idle();
  EXPECT_TRUE(runtime->stop(0ms)) << "nobody waits for a lost tuple";
  EXPECT_THAT(source->acked(), IsEmpty());
}

TEST_F(Reliability, ASecondAckOrFailIsIgnored) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper(), 2).all_grouping("in"); },
        bench.options());
  source->put(Values(1));
  settle(0, true);
  settle(0, true);
  settle(0, false);
  EXPECT_THAT(source->acked(), IsEmpty());
  EXPECT_THAT(source->failed(), IsEmpty());
  settle(1, true);
  EXPECT_THAT(source->acked(), ElementsAre(1));
  EXPECT_EQ(runtime->snapshot().component("keep").acked, 2U);
}

TEST_F(Reliability, ATupleThatNobodyReadsIsAckedAtOnce) {
  auto lonely = std::make_shared<Source>();
  start(
      [&](TopologyBuilder& builder) {
        builder.set_spout("lonely", source_spout(lonely));
        builder.set_bolt("keep", keeper()).shuffle_grouping("in");
      },
      bench.options());
  lonely->put(Values(1));
  EXPECT_THAT(lonely->acked(), ElementsAre(1));
}

TEST_F(Reliability, WithoutAckersEveryTupleIsAckedWhenEmitted) {
  auto options = bench.options();
  options.acking = false;
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); }, options);
  source->put(Values(1));
  EXPECT_THAT(source->acked(), ElementsAre(1));
  settle(0, false);
  EXPECT_THAT(source->failed(), IsEmpty());
}

TEST_F(Reliability, AsksASpoutForNoMoreThanMayBePending) {
  auto options = bench.options();
  options.max_spout_pending = 3;
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); }, options);
  for (int i = 0; i < 10; ++i) source->put(Values(i));
  EXPECT_EQ(kept.size(), 3U);
  EXPECT_EQ(source->calls().back(), "throttled");
  settle(1, true);
  EXPECT_EQ(kept.size(), 4U);
  settle(0, false);
  EXPECT_EQ(kept.size(), 5U);
  EXPECT_EQ(runtime->snapshot().component("in").pending, 3U);
}

TEST_F(Reliability, TellsHowLongTheOldestMessageHasBeenUnderWay) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); },
        bench.options());
  const auto oldest = [this] { return runtime->snapshot().component("in").oldest_seconds; };
  EXPECT_EQ(oldest(), 0);
  source->put(Values(1));
  pass(2s);
  source->put(Values(2));
  pass(1s);
  EXPECT_DOUBLE_EQ(oldest(), 3);
  settle(0, false);
  EXPECT_DOUBLE_EQ(oldest(), 1);
  settle(1, false);
  EXPECT_EQ(oldest(), 0);
}

TEST_F(Reliability, MeasuresTheTimeToTheAckByTheTopologysClock) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); },
        bench.options());
  source->put(Values(1));
  pass(1s);
  settle(0, true);
  const auto latency = runtime->snapshot().component("in").complete_latency;
  EXPECT_EQ(latency.count, 1U);
  EXPECT_EQ(latency.max_ns, 1e9);
}

TEST_F(Reliability, CountsEveryAckInItsLatencyAlsoOfThoseThatComeTogether) {
  start([this](TopologyBuilder& builder) { builder.set_bolt("keep", keeper()).shuffle_grouping("in"); },
        bench.options());
  for (int i = 0; i < 3; ++i) source->put(Values(i));
  pass(1s);
  for (int i = 0; i < 2; ++i) source->put(Values(i));
  pass(1s);
  for (std::size_t which = 0; which < 5; ++which) collectors.at(which)->ack(kept.at(which));
  runtime->run_until_idle();
  const auto latency = runtime->snapshot().component("in").complete_latency;
  EXPECT_EQ(latency.count, 5U);
  EXPECT_EQ(latency.max_ns, 2e9);
  EXPECT_EQ(latency.mean_ns, 8e9 / 5);
}

TEST(ReliabilityUnderThreads, AcksFromOtherThreadsAccountForEveryTuple) {
  auto source = std::make_shared<Source>();
  struct Shared {
    std::mutex mutex;
    std::vector<std::pair<OutputCollector*, Tuple>> waiting;
  } shared;
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt(), 2).shuffle_grouping("in");
  builder
      .set_bolt("later", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  const std::lock_guard lock(shared.mutex);
                  shared.waiting.emplace_back(&out, tuple);
                }),
                3)
      .shuffle_grouping("pass");
  Runtime runtime(builder.build("later"), options);
  runtime.start();
  constexpr std::size_t count = 3000;
  std::atomic<bool> done{false};
  const auto answer = [&] {
    std::size_t turn = 0;
    while (!done) {
      std::vector<std::pair<OutputCollector*, Tuple>> some;
      {
        const std::lock_guard lock(shared.mutex);
        some.swap(shared.waiting);
      }
      for (auto& [out, tuple] : some) ++turn % 5 == 0 ? out->fail(tuple) : out->ack(tuple);
      std::this_thread::yield();
    }
  };
  {
    std::jthread first(answer), second(answer);
    for (std::size_t i = 0; i < count; ++i) source->put(Values(i));
    EXPECT_TRUE(eventually([&] { return source->acked().size() + source->failed().size() == count; }));
    done = true;
  }
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(runtime.snapshot().component("in").pending, 0U);
}

TEST(ReliabilityUnderThreads, EveryReceiverOfATupleSettlesItsOwnDelivery) {
  constexpr std::size_t count = 2000;
  auto source = std::make_shared<Source>();
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 3;
  options.message_timeout = std::chrono::hours(1);  // on a busy machine each yield() below may cost milliseconds
  options.metrics = &metrics;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt(), 3).all_grouping("in");
  builder
      .set_bolt("last", bolt([](const Tuple& tuple, OutputCollector& out, const TopologyContext& context) {
                  if (tuple.get<std::int64_t>(0) % 8 == 0) std::this_thread::yield();
                  if (context.task_index == 0 && tuple.get<std::int64_t>(0) % 10 == 0) return out.fail(tuple);
                  out.ack(tuple);
                }),
                3)
      .all_grouping("pass");
  Runtime runtime(builder.build("many"), options);
  runtime.start();
  for (std::size_t i = 0; i < count; ++i) source->lay(Values(i));
  source->wake();
  EXPECT_TRUE(eventually([&] { return source->acked().size() + source->failed().size() == count; }));
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(source->failed().size(), count / 10);
  const Snapshot done = runtime.snapshot();
  EXPECT_EQ(done.component("last").acked + done.component("last").failed, 9 * count);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
