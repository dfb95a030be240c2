#include <future>
#include <stdexcept>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {
namespace {

using namespace std::chrono_literals;

using tests::patience;

/// Runs a callback on the loop and waits for its end.
void on_loop(EventLoop& loop, const std::function<void()>& callback) {
  std::promise<void> done;
  loop.post([&] {
    callback();
    done.set_value();
  });
  ASSERT_EQ(done.get_future().wait_for(patience), std::future_status::ready);
}

TEST(EventLoop, ATimerRunsAgainAndAgainUntilItIsStopped) {
  EventLoop loop("test");
  int runs = 0;
  std::promise<void> three;
  HandlerId id = 0;
  on_loop(loop, [&] {
    id = loop.start_timer(0us, 100us, [&] {
      if (++runs != 3) return;
      loop.stop_handler(id);
      three.set_value();
    });
  });
  ASSERT_EQ(three.get_future().wait_for(patience), std::future_status::ready);
  std::promise<void> later;
  loop.start_timer(5ms, 0us, [&] { later.set_value(); });
  ASSERT_EQ(later.get_future().wait_for(patience), std::future_status::ready);
  on_loop(loop, [&] { EXPECT_EQ(runs, 3); });
}

TEST(EventLoop, ALateTimerCatchesUpFromItsIntendedTimes) {
  EventLoop loop("test");
  int runs = 0;
  std::promise<void> enough;
  const auto begun = std::chrono::steady_clock::now();
  loop.start_timer(1ms, 1ms, [&] {
    if (++runs == 1) {  // holds the loop for 20 periods
      while (std::chrono::steady_clock::now() - begun < 20ms) {
      }
    }
    if (runs == 15) enough.set_value();
  });
  ASSERT_EQ(enough.get_future().wait_for(patience), std::future_status::ready);
  // The 15th was intended at 15 ms, before the first returned: it came at once, without 14 more periods.
  loop.stop();
  EXPECT_GE(runs, 15);
}

TEST(EventLoop, ADescriptorIsWatchedWhileItIsReadableAndStaysTheCallers) {
  int ends[2];
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM, 0, ends), 0);
  {
    EventLoop loop("test");
    std::string got;
    std::promise<void> all;
    loop.watch_descriptor(ends[0], false, [&] {
      char c = 0;  // one at a time: what is left makes it run again
      if (read(ends[0], &c, 1) == 1) got += c;
      if (got == "abc") all.set_value();
    });
    ASSERT_EQ(write(ends[1], "abc", 3), 3);
    EXPECT_EQ(all.get_future().wait_for(patience), std::future_status::ready);
  }
  EXPECT_EQ(write(ends[1], "d", 1), 1);  // still open
  char c = 0;
  EXPECT_EQ(read(ends[0], &c, 1), 1);
  close(ends[0]);
  close(ends[1]);
}

TEST(EventLoop, ACallbackThatThrowsDoesNotEndTheLoop) {
  EventLoop loop("test");
  loop.post([] { throw std::runtime_error("on purpose"); });
  bool ran = false;
  on_loop(loop, [&] { ran = true; });
  EXPECT_TRUE(ran);
}

TEST(EventLoop, ALoopThatIsStuckSaysSo) {
  EventLoop loop("test");
  std::promise<void> stuck, go_on;
  loop.post([&] {
    stuck.set_value();
    go_on.get_future().wait();
  });
  stuck.get_future().wait();
  loop.stalled();  // sends the probe
  while (loop.stalled() == 0ms) std::this_thread::yield();
  go_on.set_value();
  on_loop(loop, [] {});
  EXPECT_EQ(loop.stalled(), 0ms);
}

TEST(EventLoop, ALoopThatIsBusyWithManyCallbacksIsNotStuck) {
  std::promise<void> begun, go_on, next, end;
  EventLoop loop("test");
  loop.post([&] {
    begun.set_value();
    go_on.get_future().wait();
  });
  loop.post([&] {
    next.set_value();
    end.get_future().wait();
  });
  begun.get_future().wait();
  loop.stalled();  // its probe stands behind the second callback
  while (loop.stalled() < 20ms) std::this_thread::yield();
  go_on.set_value();
  next.get_future().wait();
  EXPECT_EQ(loop.stalled(), 0ms) << "the first callback has ended, though the probe is not answered";
  while (loop.stalled() == 0ms) std::this_thread::yield();
  end.set_value();
}

TEST(EventLoop, ItMayBeDestroyedFromItsOwnCallback) {
  auto loop = std::make_unique<EventLoop>("test");
  std::promise<void> posted, gone;
  loop->post([&] {
    posted.get_future().wait();  // until post() has let go of the loop
    loop.reset();
    gone.set_value();
  });
  posted.set_value();
  EXPECT_EQ(gone.get_future().wait_for(patience), std::future_status::ready);
}

}  // namespace
}  // namespace iotcloud::gateway
