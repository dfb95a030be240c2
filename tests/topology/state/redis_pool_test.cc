// When a pool asks a Redis that fails again, on a clock that the test moves. No Redis runs: the test is the server.
#include <chrono>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/topology/state/redis/redis_pool.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {
namespace {

using testing::HasSubstr;

/// A port of the loopback interface at which connections wait that nobody answers.
class SilentServer {
 public:
  SilentServer() : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    EXPECT_EQ(::bind(socket_, reinterpret_cast<const sockaddr*>(&address), size), 0);
    EXPECT_EQ(::listen(socket_, 8), 0);
    ::getsockname(socket_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  }
  ~SilentServer() { ::close(socket_); }
  SilentServer(const SilentServer&) = delete;
  SilentServer& operator=(const SilentServer&) = delete;

  RedisAddress address() const {
    RedisAddress address;
    address.text = "redis://127.0.0.1";
    address.servers = {{"127.0.0.1", port_}};
    return address;
  }
  /// How many connections have come since the last call.
  int connections() const {
    int count = 0;
    for (int connection; (connection = ::accept(socket_, nullptr, nullptr)) >= 0; ++count) ::close(connection);
    return count;
  }

 private:
  const int socket_;
  std::uint16_t port_ = 0;
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
  const tests::HandClock clock;
  RedisPool pool(server.address(), clock);
  const std::string first = trouble(pool);
  EXPECT_THAT(first, HasSubstr("no answer within"));
  EXPECT_EQ(server.connections(), 1);
  // That took two seconds, which the injected clock has not seen.
  EXPECT_EQ(trouble(pool), first);
  EXPECT_EQ(server.connections(), 0);
}

TEST(RedisPoolTest, WhenThatWhileIsOverItAsksAgain) {
  const SilentServer server;
  tests::HandClock clock;
  RedisPool pool(server.address(), clock);
  EXPECT_THAT(trouble(pool), HasSubstr("no answer within"));
  EXPECT_EQ(server.connections(), 1);
  clock.advance(std::chrono::milliseconds(200));
  EXPECT_THAT(trouble(pool), HasSubstr("no answer within"));
  EXPECT_EQ(server.connections(), 1);
}

}  // namespace
}  // namespace iotcloud::topology::internal
