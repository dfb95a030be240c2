// What a spout says when its prefetch holds the topology up.
#include <cstdint>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/captured_log.h>
#include <iotcloud/topology/endpoints/receiving/prefetch_report.h>

namespace iotcloud::topology {
namespace {

class PrefetchReportTest : public testing::Test {
 protected:
  PrefetchReportTest() {
    services_->topology = discovery::TopologyName("t");
    services_->metrics = &metrics_;
  }
  std::int64_t metric(const std::string& name) {
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == name) return static_cast<std::int64_t>(sample.value);
    }
    return -1;
  }

  config::Metrics metrics_;
  const EndpointServicesPtr services_ = std::make_shared<EndpointServices>();
};

TEST_F(PrefetchReportTest, ThreeLooksInARowThatFindAFullChannelMakeALimit) {
  const tests::CapturedLog log;
  PrefetchReport report(services_, "in", false);
  report.look(2, 100);
  report.look(2, 100);
  report.look(0, 100);
  report.look(2, 100);
  report.look(2, 100);
  EXPECT_EQ(metric("iotcloud_spout_prefetch"), 100);
  EXPECT_EQ(metric("iotcloud_spout_prefetch_limited"), 0);
  EXPECT_FALSE(log.contains("is the limit"));
  report.look(2, 100);
  EXPECT_EQ(metric("iotcloud_spout_prefetch_limited"), 2);
  EXPECT_TRUE(log.contains("in: prefetchCount (100) is the limit: of 2 channel(s)"));
  EXPECT_TRUE(log.contains("a bolt acks late; set prefetchCount above"));
  EXPECT_THAT(services_->held->limits(), testing::Not(testing::IsEmpty()));
  report.look(0, 100);
  EXPECT_EQ(metric("iotcloud_spout_prefetch_limited"), 0);
  EXPECT_THAT(services_->held->limits(), testing::IsEmpty());
}

TEST_F(PrefetchReportTest, TheTextNamesTheBoltsThatKeepTuplesAndWhatToDo) {
  services_->keepers["in"] = "window (10 s)";
  const tests::CapturedLog log;
  PrefetchReport raised(services_, "in", false);
  for (int i = 0; i < 3; ++i) raised.look(1, 800);
  EXPECT_TRUE(log.contains("bolts keep tuples: window (10 s); it was not raised further"));
  PrefetchReport fixed(services_, "in", true);
  for (int i = 0; i < 3; ++i) fixed.look(1, 20);
  EXPECT_TRUE(log.contains("bolts keep tuples: window (10 s); set prefetchCount above"));
}

}  // namespace
}  // namespace iotcloud::topology
