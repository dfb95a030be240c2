#include <gtest/gtest.h>

#include <iotcloud/gateway/fleet/host_brokers.h>

namespace iotcloud::gateway {
namespace {

constexpr std::int64_t a_second = 1000;

TEST(HostBrokers, NameABrokerThatHostsCannotReachOnceSinceWhenAndWhy) {
  HostBrokers brokers;
  EXPECT_EQ(brokers.trouble(100 * a_second), "");
  brokers.put("one", {{"red", "amqp://red/", "away", 7 * a_second, "connection refused"},
                      {"blue", "amqp://blue/", "connected", 0, ""}});
  brokers.put("two", {{"red", "amqp://red/", "away", 5 * a_second, "connection closed"}});
  EXPECT_EQ(brokers.trouble(100 * a_second),
            "the broker red (amqp://red/) is away since 1970-01-01T00:00:05Z: connection closed");
  brokers.put("two", {{"blue", "amqp://blue/", "takes no messages", 9 * a_second, ""}});
  EXPECT_EQ(brokers.trouble(100 * a_second),
            "the broker blue (amqp://blue/) takes no messages since 1970-01-01T00:00:09Z; "
            "the broker red (amqp://red/) is away since 1970-01-01T00:00:07Z: connection refused");
  brokers.forget("one");
  brokers.put("two", {});
  EXPECT_EQ(brokers.trouble(100 * a_second), "");
}

TEST(HostBrokers, OneThatIsJustConnectingIsNoTrouble) {
  HostBrokers brokers;
  brokers.put("one", {{"red", "amqp://red/", "away", 10'000, ""}});
  EXPECT_EQ(brokers.trouble(10'000 + HostBrokers::grace.count() - 1), "");
  EXPECT_NE(brokers.trouble(10'000 + HostBrokers::grace.count()), "");
}

}  // namespace
}  // namespace iotcloud::gateway
