// What wakes a connection's thread and what does not.
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"

#include <array>
#include <chrono>
#include <thread>
#include <utility>

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

using namespace std::chrono_literals;

constexpr std::chrono::milliseconds moment{20};
constexpr std::chrono::milliseconds long_time{60'000};

/// Whether the sleep ended before its limit, however busy the machine is.
bool ends_by_itself(LinkSleep& sleep) {
  const auto began = std::chrono::steady_clock::now();
  const bool readable = sleep.wait(long_time).readable;
  return !readable && std::chrono::steady_clock::now() - began < long_time;
}

/// Two ends of a connection.
class Pair {
 public:
  Pair() { EXPECT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends_.data()), 0); }
  ~Pair() {
    for (const int end : ends_) {
      if (end >= 0) ::close(end);
    }
  }
  Pair(const Pair&) = delete;
  Pair& operator=(const Pair&) = delete;
  int ours() const { return ends_[0]; }
  void other_writes() const { EXPECT_EQ(::write(ends_[1], "x", 1), 1); }
  void other_closes() { ::close(std::exchange(ends_[1], -1)); }

 private:
  std::array<int, 2> ends_{-1, -1};
};

TEST(LinkSleep, EndsWhenTheSocketCanBeRead) {
  LinkSleep sleep;
  const Pair pair;
  sleep.watch(pair.ours(), false);
  EXPECT_FALSE(sleep.wait(moment).readable);
  pair.other_writes();
  const LinkSleep::Result woken = sleep.wait(long_time);
  EXPECT_TRUE(woken.readable);
  EXPECT_FALSE(woken.writable);
}

TEST(LinkSleep, EndsWhenTheSocketCanBeWrittenOnlyIfThatIsAskedFor) {
  LinkSleep sleep;
  const Pair pair;
  sleep.watch(pair.ours(), false);
  EXPECT_FALSE(sleep.wait(moment).writable);
  sleep.watch(pair.ours(), true);
  EXPECT_TRUE(sleep.wait(long_time).writable);
}

TEST(LinkSleep, EndsWhenAnotherThreadSignals) {
  LinkSleep sleep;
  const std::jthread other([&] { sleep.signal(); });
  EXPECT_TRUE(ends_by_itself(sleep));
}

TEST(LinkSleep, WhatTheSocketBringsDoesNotEndItOnceItWasPutOff) {
  LinkSleep sleep;
  const Pair pair;
  sleep.watch(pair.ours(), false);
  sleep.put_off(900ms);
  pair.other_writes();
  EXPECT_FALSE(sleep.wait(moment).readable);
  sleep.watch(pair.ours(), false);
  EXPECT_TRUE(sleep.wait(long_time).readable) << "the next sleep is an ordinary one";
}

TEST(LinkSleep, EndsByItselfWhenTheTimeItWasPutOffForIsOver) {
  LinkSleep sleep;
  const Pair pair;
  sleep.watch(pair.ours(), false);
  sleep.put_off(2ms);
  EXPECT_TRUE(ends_by_itself(sleep));
}

TEST(LinkSleep, EndsByItselfWhenNoTimeIsLeft) {
  LinkSleep sleep;
  sleep.signal_after(-1ms);
  EXPECT_TRUE(ends_by_itself(sleep));
}

TEST(LinkSleep, ABrokenConnectionEndsItThoughItWasPutOff) {
  LinkSleep sleep;
  Pair pair;
  sleep.watch(pair.ours(), false);
  sleep.put_off(900ms);
  pair.other_closes();
  EXPECT_TRUE(sleep.wait(long_time).readable);
}

TEST(LinkSleep, ANewSocketWithTheNumberOfAClosedOneIsWatched) {
  LinkSleep sleep;
  int number = -1;
  {
    const Pair first;
    number = first.ours();
    sleep.watch(number, false);
  }
  const Pair second;
  ASSERT_EQ(second.ours(), number) << "the lowest that is free";
  sleep.watch(second.ours(), false);
  second.other_writes();
  EXPECT_TRUE(sleep.wait(long_time).readable);
}

TEST(LinkSleep, ASocketThatIsNotWatchedAnyMoreDoesNotEndIt) {
  LinkSleep sleep;
  const Pair pair;
  sleep.watch(pair.ours(), false);
  sleep.watch(-1, false);
  pair.other_writes();
  EXPECT_FALSE(sleep.wait(moment).readable);
  sleep.watch(pair.ours(), false);
  EXPECT_TRUE(sleep.wait(long_time).readable);
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
