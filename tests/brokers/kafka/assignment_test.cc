// How a group's members share its partitions, by the version of librdkafka.
#include "iotcloud/brokers/kafka/reading/assignment.h"

#include <gtest/gtest.h>

namespace iotcloud::brokers::kafka {
namespace {

TEST(KafkaAssignment, IsCooperativeOnlyWithALibraryThatSurvivesIt) {
  EXPECT_STREQ(assignment_strategy(0x020002ff), "roundrobin") << "2.0.2, of Debian 12";
  EXPECT_STREQ(assignment_strategy(0x020200ff), "roundrobin") << "2.2.0, the last one that aborts";
  EXPECT_STREQ(assignment_strategy(0x020503ff), "roundrobin")
      << "2.5.3, the last one whose leader may compute for ever";
  EXPECT_STREQ(assignment_strategy(0x020600ff), "cooperative-sticky") << "2.6.0";
  EXPECT_STREQ(assignment_strategy(0x030000ff), "cooperative-sticky");
  EXPECT_FALSE(is_cooperative(0x020503ff));
  EXPECT_TRUE(is_cooperative(0x020600ff));
}

}  // namespace
}  // namespace iotcloud::brokers::kafka
