#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/master/cli/fleet/topology_plan.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::master::cli {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

Manifest manifest(int workers = 2) {
  Manifest wanted;
  wanted.fleet = "lab";
  wanted.topologies = {{"echo"_topology, "echo.yaml", workers, {}, "one"}};
  return wanted;
}

/// "KIND TOPOLOGY: what"
std::vector<std::string> steps(const TopologyPlan& plan) {
  std::vector<std::string> words;
  for (const auto& step : plan.steps) {
    std::string text = to_string(step.kind) + " " + step.topology;
    for (const auto& what : step.what) text += ": " + what;
    words.push_back(std::move(text));
  }
  return words;
}

TEST(TopologyPlan, SubmitsWhatIsMissingAndLeavesWhatIsAsItShouldBe) {
  EXPECT_THAT(steps(make_topology_plan(manifest(), {}, true, false)), ElementsAre("submit echo"));
  const auto plan = make_topology_plan(manifest(), {{"echo"_topology, "one", 2, "lab"}}, true, false);
  EXPECT_THAT(plan.steps, IsEmpty());
  EXPECT_EQ(plan.same, 1u);
}

TEST(TopologyPlan, UpdatesWhatDiffers) {
  const auto plan = make_topology_plan(manifest(), {{"echo"_topology, "another", 1, "lab"}}, true, false);
  EXPECT_THAT(steps(plan), ElementsAre("update echo: its file, or a library, is another: workers: 1 -> 2"));
}

TEST(TopologyPlan, KillsOnlyWhatTheManifestSubmittedAndNamesNoMore) {
  const std::vector<PresentTopology> present{{"gone"_topology, "x", 1, "lab"},
                                             {"of-a-person"_topology, "x", 1, ""},
                                             {"of-another"_topology, "x", 1, "hall"},
                                             {"by-hand"_topology, "", 0, ""}};
  EXPECT_THAT(steps(make_topology_plan(manifest(), present, true, false)), ElementsAre("kill gone", "submit echo"));
  const auto plan = make_topology_plan(manifest(), present, false, false);
  EXPECT_THAT(steps(plan), ElementsAre("submit echo"));
  EXPECT_THAT(plan.kept, ElementsAre("gone"_topology));
}

TEST(TopologyPlan, TakesOverWhatOthersSubmittedOnlyWhenItMay) {
  const std::vector<PresentTopology> present{{"echo"_topology, "one", 2, ""}};
  const auto plan = make_topology_plan(manifest(), present, true, false);
  EXPECT_THAT(plan.steps, IsEmpty());
  ASSERT_THAT(plan.problems, SizeIs(1));
  EXPECT_THAT(plan.problems[0].second, HasSubstr("--adopt"));
  EXPECT_THAT(steps(make_topology_plan(manifest(), present, true, true)), ElementsAre("adopt echo"));
}

TEST(TopologyPlan, TouchesNoWorkersThatWereStartedByHand) {
  const auto plan = make_topology_plan(manifest(), {{"echo"_topology, "", 0, ""}}, true, true);
  EXPECT_THAT(plan.steps, IsEmpty());
  ASSERT_THAT(plan.problems, SizeIs(1));
  EXPECT_THAT(plan.problems[0].second, HasSubstr("started by hand"));
}

}  // namespace
}  // namespace iotcloud::master::cli
