#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/topology/worker/left_behind.h>

namespace iotcloud::topology {
namespace {

TaskSnapshot task(const std::string& component, std::size_t pending, std::size_t queue_depth) {
  TaskSnapshot snapshot;
  snapshot.component = component;
  snapshot.pending = pending;
  snapshot.queue_depth = queue_depth;
  return snapshot;
}

TEST(LeftBehind, SaysWhatIsUnderWayWhereItWaitsAndWhoKeepsItByDesign) {
  Topology topology;
  topology.components.resize(2);
  topology.components[1].id = "mean";
  topology.components[1].holds = std::chrono::seconds(10);
  Snapshot snapshot;
  snapshot.tasks = {task("in", 5, 0), task("in", 7, 0), task("mean", 0, 0)};
  EXPECT_EQ(
      left_behind(topology, snapshot),
      "tuples under way: 12 of in; these bolts keep tuples by design until a window or checkpoint ends: mean (for up "
      "to 10000 ms); spouts that acknowledge read them again");
  snapshot.tasks.back().queue_depth = 3;
  EXPECT_THAT(left_behind(topology, snapshot), testing::HasSubstr("12 of in; waiting: 3 before mean; these bolts"));
  EXPECT_EQ(left_behind(topology, {}), "");
  topology.components[1].holds = Bolt::until_others_come;
  EXPECT_THAT(left_behind(topology, snapshot), testing::HasSubstr("mean (until enough others have come);"));
}

TEST(LeftBehind, NamesNoKeeperWhenThereIsNone) {
  Snapshot snapshot;
  snapshot.tasks = {task("in", 1, 0), task("slow", 0, 1)};
  EXPECT_EQ(left_behind({}, snapshot),
            "tuples under way: 1 of in; waiting: 1 before slow; spouts that acknowledge read them again");
}

}  // namespace
}  // namespace iotcloud::topology
