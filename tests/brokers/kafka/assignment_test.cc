// How a group's members share its partitions, by the version of librdkafka.
#include "iotcloud/brokers/kafka/reading/assignment.h"

#include <gtest/gtest.h>

namespace iotcloud::brokers::kafka {
namespace {

TEST(KafkaAssignment, IsCooperativeOnlyWithALibraryThatSurvivesIt) {
  EXPECT_STREQ(assignment_strategy(0x020002ff), "roundrobin") << "2.0.2, of Debian 12";
  EXPECT_STREQ(assignment_strategy(0x020102ff), "roundrobin") << "2.1.2, the last one that aborts";
  EXPECT_STREQ(assignment_strategy(0x020200ff), "cooperative-sticky") << "2.2.0";
  EXPECT_STREQ(assignment_strategy(0x030000ff), "cooperative-sticky");
}

}  // namespace
}  // namespace iotcloud::brokers::kafka
