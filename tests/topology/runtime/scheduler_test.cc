// The scheduler alone, with things to run that are no tasks of a topology.
#include <atomic>
#include <functional>
#include <latch>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/runtime/scheduling/executors.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>

namespace iotcloud::topology::internal {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

/// Time stands still unless a test moves it.
class HandClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  void move(std::chrono::nanoseconds by) { now_ += by; }

 private:
  Instant now_{1h};
};

/// Each slice is a call of the test's.
class Job final : public Runnable {
 public:
  Job(Executors& executors, std::function<bool(Lane&)> work, Role role = Role::worker, int home = anywhere)
      : Runnable(executors, role, home), work_(std::move(work)) {}
  bool slice(Lane& lane) override {
    const OwnCall own(lane, *this);
    return work_(lane);
  }
  std::int64_t worth_moving_ns() const override { return worth_ns; }
  void signal(std::uint32_t bits) override { signals.push_back(bits); }
  void hangs(std::int64_t for_ns) override { hung_ns.push_back(for_ns); }

  std::int64_t worth_ns = 0;
  std::vector<std::uint32_t> signals;
  std::vector<std::int64_t> hung_ns;

 private:
  const std::function<bool(Lane&)> work_;
};

class SchedulerTest : public testing::Test {
 protected:
  std::function<bool(Lane&)> note(const std::string& name) {
    return [this, name](Lane&) {
      done_.push_back(name);
      return false;
    };
  }

  HandClock clock_;
  Timers timers_{clock_, false};
  Executors many_{10, 10};
  std::vector<std::string> done_;
  Scheduler scheduler_{0, 1000us, 1000us, [](Scheduler& scheduler) { return std::make_unique<Lane>(scheduler); },
                       timers_};
};

TEST_F(SchedulerTest, NothingRunsBeforeItIsReleasedAndWhatWasAskedForMeanwhileIsNotLost) {
  Job job(many_, note("job"));
  scheduler_.schedule(job);
  scheduler_.run_until_idle();
  EXPECT_THAT(done_, IsEmpty());
  scheduler_.release(job, false);
  scheduler_.run_until_idle();
  EXPECT_THAT(done_, ElementsAre("job"));
  EXPECT_TRUE(scheduler_.idle());
}

TEST_F(SchedulerTest, WhatIsMadeReadyInASliceRunsOnTheSameLaneAfterIt) {
  Lane* first = nullptr;
  Lane* second = nullptr;
  Job behind(many_, [&](Lane& lane) {
    second = &lane;
    done_.push_back("behind");
    return false;
  });
  Job ahead(many_, [&](Lane& lane) {
    first = &lane;
    scheduler_.schedule(behind);
    scheduler_.schedule(behind);  // one slice for all news
    done_.push_back("ahead");
    return false;
  });
  scheduler_.release(behind, false);
  scheduler_.release(ahead, false);
  scheduler_.run_now(ahead);
  EXPECT_THAT(done_, ElementsAre("ahead", "behind"));
  EXPECT_EQ(first, second);
}

TEST_F(SchedulerTest, WhatASliceHasTakenRunsNextAndNobodyElseMayTakeIt) {
  Job behind(many_, note("behind"));
  Job taken(many_, note("taken"));
  Job ahead(many_, [&](Lane&) {
    scheduler_.schedule(behind);
    EXPECT_TRUE(scheduler_.take(taken));
    EXPECT_FALSE(scheduler_.take(taken));
    scheduler_.schedule(taken);  // it will run anyway
    scheduler_.run_taken(taken, true, false);
    EXPECT_FALSE(scheduler_.idle());
    done_.push_back("ahead");
    return false;
  });
  for (Job* job : {&behind, &taken, &ahead}) scheduler_.release(*job, false);
  scheduler_.run_now(ahead);
  EXPECT_THAT(done_, ElementsAre("ahead", "taken", "behind"));
  EXPECT_TRUE(scheduler_.idle());
  EXPECT_TRUE(scheduler_.take(taken));  // outside of slices: it waits for the pool
  scheduler_.run_taken(taken, true, false);
  scheduler_.run_until_idle();
  EXPECT_EQ(done_.back(), "taken");
}

TEST_F(SchedulerTest, ASourceWaitsUntilTheOthersAreDoneButNotForLong) {
  int sources = 0, long_ones = 0;
  Job source(
      many_,
      [&](Lane&) {
        done_.push_back("source");
        return ++sources < 2;
      },
      Runnable::Role::source);
  Job long_one(many_, [&](Lane& lane) {
    done_.push_back("long");
    lane.now_ns += 800'000;  // as if it had taken so long
    return ++long_ones < 4;
  });
  Job begin(many_, [&](Lane&) {
    scheduler_.schedule(source);
    scheduler_.schedule(long_one);
    return false;
  });
  for (Job* job : {&source, &long_one, &begin}) scheduler_.release(*job, false);
  scheduler_.run_now(begin);
  EXPECT_THAT(done_, ElementsAre("long", "long", "source", "long", "long", "source"));
}

TEST_F(SchedulerTest, NewsDuringASliceIsAnotherSlice) {
  Job* self = nullptr;
  Job job(many_, [&](Lane&) {
    done_.push_back("slice");
    if (done_.size() == 1) scheduler_.schedule(*self);
    return false;
  });
  self = &job;
  scheduler_.release(job, true);
  scheduler_.run_until_idle();
  EXPECT_THAT(done_, ElementsAre("slice", "slice"));
}

TEST_F(SchedulerTest, WhoHasMoreToDoLetsOthersThatAreReadyRunFirst) {
  Job long_one(many_, [&](Lane&) {
    done_.push_back("long");
    return done_.size() < 3;
  });
  Job other(many_, note("other"));
  Job both(many_, [&](Lane&) {
    scheduler_.schedule(long_one);
    scheduler_.schedule(other);
    return false;
  });
  for (Job* job : {&long_one, &other, &both}) scheduler_.release(*job, false);
  scheduler_.run_now(both);
  EXPECT_THAT(done_, ElementsAre("long", "other", "long"));
}

TEST_F(SchedulerTest, WithOneExecutorASecondJobStandsAsideUntilTheFirstIsDone) {
  Executors one(1, 2);
  Job aside(one, note("aside"));
  Job first(one, [&](Lane&) {
    std::thread([&] { scheduler_.run_now(aside); }).join();
    done_.push_back("first");
    return false;
  });
  scheduler_.release(first, true);
  scheduler_.release(aside, false);
  scheduler_.run_until_idle();
  EXPECT_THAT(done_, ElementsAre("first", "aside"));
}

/// A pool of two threads. The first job stays on one of them, or this one has never been awake; the second job runs
/// `act` on the other one.
class SchedulerHomesTest : public SchedulerTest {
 protected:
  void run(bool both_awake, const std::function<void(Lane&)>& act) {
    std::latch began(1), may_end(1), ended(1);
    Job first(many_, [&](Lane&) {
      first_thread_ = std::this_thread::get_id();
      began.count_down();
      may_end.wait();
      return false;
    });
    Job second(many_, [&](Lane& lane) {
      second_thread_ = std::this_thread::get_id();
      act(lane);
      ended.count_down();
      return false;
    });
    for (Job* job : {&first, &second, &home_0_, &home_1_, &homeless_}) pool_.release(*job, false);
    pool_.start();
    if (both_awake) {
      pool_.schedule(first);
      began.wait();
    }
    pool_.schedule(second);
    ended.wait();
    may_end.count_down();
    ASSERT_TRUE(pool_.wait_idle(std::chrono::steady_clock::now() + 60s, [] { return true; }));
    pool_.halt();
    pool_.join();
  }
  std::function<bool(Lane&)> tell(std::thread::id& thread) {
    return [&thread](Lane&) {
      thread = std::this_thread::get_id();
      return false;
    };
  }
  std::thread::id first_thread_, second_thread_, thread_of_0_, thread_of_1_, thread_of_homeless_;
  Scheduler pool_{2, 1h, 1h, [](Scheduler& scheduler) { return std::make_unique<Lane>(scheduler); }, timers_};
  Job home_0_{many_, tell(thread_of_0_), Runnable::Role::worker, 0};
  Job home_1_{many_, tell(thread_of_1_), Runnable::Role::worker, 1};
  Job homeless_{many_, tell(thread_of_homeless_)};
};

TEST_F(SchedulerHomesTest, WhoHasMuchToDoRunsAtHomeWhileThatThreadIsAwake) {
  run(true, [&](Lane& lane) {
    lane.now_ns = 0;  // the first job has not been running for long, however slow the machine is
    for (Job* job : {&home_0_, &home_1_, &homeless_}) pool_.schedule(*job, true);
  });
  EXPECT_THAT((std::vector{thread_of_0_, thread_of_1_}), UnorderedElementsAre(first_thread_, second_thread_));
  EXPECT_EQ(thread_of_homeless_, second_thread_);
}

TEST_F(SchedulerHomesTest, WhoseHomeIsInALongSliceRunsWhereItBecameReady) {
  run(true, [&](Lane& lane) {
    lane.now_ns = real_ns() + 1'000'000'000;
    for (Job* job : {&home_0_, &home_1_}) pool_.schedule(*job, true);
  });
  EXPECT_EQ(thread_of_0_, second_thread_);
  EXPECT_EQ(thread_of_1_, second_thread_);
}

TEST_F(SchedulerHomesTest, WhoHasLittleToDoRunsWhereItBecameReady) {
  run(true, [&](Lane& lane) {
    lane.now_ns = 0;
    for (Job* job : {&home_0_, &home_1_}) pool_.schedule(*job);
  });
  EXPECT_EQ(thread_of_0_, second_thread_);
  EXPECT_EQ(thread_of_1_, second_thread_);
}

TEST_F(SchedulerHomesTest, WhoseHomeIsAsleepRunsWhereItBecameReady) {
  run(false, [&](Lane&) {
    for (Job* job : {&home_0_, &home_1_}) {
      ASSERT_TRUE(pool_.take(*job));
      pool_.run_taken(*job, false, true);
    }
  });
  EXPECT_EQ(thread_of_0_, second_thread_);
  EXPECT_EQ(thread_of_1_, second_thread_);
}

/// A pool thread that has worked for long makes two jobs ready, while the other thread sleeps as a rule.
class SchedulerSharesTest : public SchedulerTest {
 protected:
  static constexpr std::int64_t long_ns = 500'000;
  SchedulerSharesTest() {
    for (Job* job : {&busy_, &first_, &second_}) pool_.release(*job, false);
    pool_.start();
  }
  ~SchedulerSharesTest() override {
    pool_.halt();
    pool_.join();
  }
  /// \return whether the second job ran beside the first one
  bool share(std::int64_t worth_ns) {
    first_.worth_ns = second_.worth_ns = worth_ns;
    second_began_ = beside_ = false;
    pool_.schedule(busy_);
    EXPECT_TRUE(pool_.wait_idle(std::chrono::steady_clock::now() + 60s, [] { return true; }));
    return beside_;
  }

  std::atomic<bool> second_began_{false}, beside_{false};
  Scheduler pool_{2, 1h, 1h, [](Scheduler& scheduler) { return std::make_unique<Lane>(scheduler); }, timers_};
  Job first_{many_, [&](Lane&) {
               const auto limit = std::chrono::steady_clock::now() + 50ms;
               while (!second_began_ && std::chrono::steady_clock::now() < limit) std::this_thread::yield();
               beside_ = second_began_.load();
               return false;
             }};
  Job second_{many_, [&](Lane&) {
                second_began_ = true;
                return false;
              }};
  Job busy_{many_, [&](Lane& lane) {
              for (Job* job : {&first_, &second_}) pool_.schedule(*job);
              lane.now_ns += long_ns;
              return false;
            }};
};

TEST_F(SchedulerSharesTest, WorkThatIsWorthASecondThreadIsDoneByOneThatSleeps) {
  const auto limit = std::chrono::steady_clock::now() + 60s;
  while (!share(Scheduler::worth_sharing_ns / 2)) ASSERT_LT(std::chrono::steady_clock::now(), limit);
}

TEST_F(SchedulerSharesTest, WorkThatIsWorthLessStaysOnItsThread) {
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(share(Scheduler::worth_sharing_ns / 2 - 1));
}

TEST_F(SchedulerTest, AJobThatHangsIsToldOnceInEachSlice) {
  Job* self = nullptr;
  Job job(many_, [&](Lane&) {
    scheduler_.report_hanging(0ms);
    scheduler_.report_hanging(0ms);
    EXPECT_TRUE(scheduler_.runs(*self));
    return false;
  });
  self = &job;
  scheduler_.release(job, true);
  scheduler_.run_until_idle();
  EXPECT_EQ(job.hung_ns.size(), 1u);
  EXPECT_FALSE(scheduler_.runs(job));
}

TEST_F(SchedulerTest, AfterAHaltNothingStarts) {
  Job job(many_, note("job"));
  scheduler_.halt();
  scheduler_.release(job, true);
  scheduler_.run_until_idle();
  EXPECT_THAT(done_, IsEmpty());
}

TEST_F(SchedulerTest, TimersSignalWhenTheirTimeHasComeAndPeriodicOnesAgain) {
  Job job(many_, note("job"));
  timers_.add(clock_.now() + 2s, job, 4);
  timers_.add(clock_.now() + 1s, job, 1, 1s);
  timers_.run_due();
  EXPECT_THAT(job.signals, IsEmpty());
  clock_.move(2500ms);  // the tick of the second second was missed, it comes once
  timers_.run_due();
  EXPECT_THAT(job.signals, ElementsAre(1, 4));
  clock_.move(500ms);
  timers_.run_due();
  EXPECT_THAT(job.signals, ElementsAre(1, 4, 1));
  timers_.end_periodic();
  clock_.move(10s);
  timers_.run_due();
  EXPECT_THAT(job.signals, ElementsAre(1, 4, 1));
}

}  // namespace
}  // namespace iotcloud::topology::internal
