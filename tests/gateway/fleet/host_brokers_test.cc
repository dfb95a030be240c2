#include <gtest/gtest.h>

#include <iotcloud/gateway/fleet/host_brokers.h>

namespace iotcloud::gateway {
namespace {

using namespace std::chrono_literals;

constexpr std::int64_t a_second = 1000;
constexpr config::Clock::Instant start{1h};

TEST(HostBrokers, NameABrokerThatHostsCannotReachOnceSinceWhenAndWhy) {
  HostBrokers brokers;
  EXPECT_EQ(brokers.trouble(start + 5s), "");
  brokers.put("one",
              {{"red", "amqp://red/", "away", 7 * a_second, "connection refused"},
               {"blue", "amqp://blue/", "connected", 0, ""}},
              start);
  brokers.put("two", {{"red", "amqp://red/", "away", 5 * a_second, "connection closed"}}, start);
  EXPECT_EQ(brokers.trouble(start + 5s),
            "the broker red (amqp://red/) is away since 1970-01-01T00:00:05Z: connection closed "
            "(start its server, or correct `brokers`)");
  brokers.put("two", {{"blue", "amqp://blue/", "takes no messages", 9 * a_second, ""}}, start);
  EXPECT_EQ(brokers.trouble(start + 5s),
            "the broker blue (amqp://blue/) takes no messages since 1970-01-01T00:00:09Z; "
            "the broker red (amqp://red/) is away since 1970-01-01T00:00:07Z: connection refused "
            "(start its server, or correct `brokers`)");
  brokers.forget("one");
  brokers.put("two", {}, start);
  EXPECT_EQ(brokers.trouble(start + 5s), "");
}

TEST(HostBrokers, OneThatIsJustConnectingIsNoTrouble) {
  HostBrokers brokers;
  const std::vector<BrokerLink> away{{"red", "amqp://red/", "away", 10'000, ""}};
  brokers.put("one", away, start);
  EXPECT_EQ(brokers.trouble(start + HostBrokers::grace - 1ms), "");
  brokers.put("one", away, start + 200ms);
  EXPECT_NE(brokers.trouble(start + HostBrokers::grace), "") << "told again is not from anew";
  brokers.put("one", {{"red", "amqp://red/", "connected", 11'000, ""}}, start + 1s);
  brokers.put("one", {{"red", "amqp://red/", "away", 12'000, ""}}, start + 2s);
  EXPECT_EQ(brokers.trouble(start + 2s), "");
}

TEST(HostBrokers, ATimeOfDayThatWasSetBackHidesNoTrouble) {
  HostBrokers brokers;
  const std::int64_t far_ahead = 4'000'000'000 * a_second;
  brokers.put("one", {{"red", "amqp://red/", "away", far_ahead, ""}}, start);
  EXPECT_NE(brokers.trouble(start + HostBrokers::grace), "");
}

}  // namespace
}  // namespace iotcloud::gateway
