// When a pool asks a Redis that fails again, on a clock that the test moves. No Redis runs: the test is the server.
#include <chrono>
#include <string>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/topology/state/redis/redis_pool.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {
namespace {

using testing::HasSubstr;

/// Connections wait at it that nobody answers.
class SilentServer {
 public:
  SilentServer() { EXPECT_EQ(::fcntl(listener_.socket(), F_SETFL, O_NONBLOCK), 0); }

  RedisAddress address() const {
    RedisAddress address;
    address.text = "redis://127.0.0.1";
    address.servers = {{"127.0.0.1", listener_.port()}};
    return address;
  }
  /// How many connections have come since the last call.
  int connections() const {
    int count = 0;
    for (int connection = 0; (connection = listener_.accept()) >= 0; ++count) ::close(connection);
    return count;
  }

 private:
  const tests::LoopbackListener listener_;
};

/// Why the pool cannot ask.
std::string trouble(RedisPool& pool) {
  try {
    pool.ask({"PING"});
  } catch (const StateUnavailable& error) {
    return error.what();
  }
  return "";
}

TEST(RedisPoolTest, AfterAFailureItAsksNobodyForAWhileOfTheInjectedClock) {
  const SilentServer server;
  tests::HandClock clock;
  RedisPool pool(server.address(), clock);
  const std::string first = trouble(pool);
  EXPECT_THAT(first, HasSubstr("no answer within"));
  EXPECT_EQ(server.connections(), 1);
  // That took two seconds, which the injected clock has not seen.
  EXPECT_EQ(trouble(pool), first);
  EXPECT_EQ(server.connections(), 0);
  clock.advance(std::chrono::milliseconds(200));
  EXPECT_THAT(trouble(pool), HasSubstr("no answer within"));
  EXPECT_EQ(server.connections(), 1);
}

}  // namespace
}  // namespace iotcloud::topology::internal
