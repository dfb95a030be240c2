#include <gtest/gtest.h>

#include <iotcloud/gateway/fleet/host_metrics.h>
#include <iotcloud/gateway/host/broker_states.h>

namespace iotcloud::gateway {
namespace {

config::Sample broker_is_away(const std::string& broker, double value) {
  config::Sample sample;
  sample.name = broker_away_metric;
  sample.labels = {{"plugin", "probe"}, {"broker", broker}, {"url", "amqp://" + broker + "/"}};
  sample.kind = config::Sample::Kind::gauge;
  sample.value = value;
  return sample;
}

TEST(HostMetrics, NameABrokerThatHostsCannotReachOnce) {
  HostMetrics metrics;
  EXPECT_EQ(metrics.brokers_away(), "");
  metrics.put("one", 1, {broker_is_away("red", 1), broker_is_away("blue", 0)});
  metrics.put("two", 2, {broker_is_away("red", 1)});
  EXPECT_EQ(metrics.brokers_away(), "the broker red (amqp://red/) is away");
  metrics.put("two", 2, {broker_is_away("blue", 1)});
  EXPECT_EQ(metrics.brokers_away(), "the broker blue (amqp://blue/) is away; the broker red (amqp://red/) is away");
  metrics.forget("one", 1);
  metrics.put("two", 2, {});
  EXPECT_EQ(metrics.brokers_away(), "");
}

}  // namespace
}  // namespace iotcloud::gateway
