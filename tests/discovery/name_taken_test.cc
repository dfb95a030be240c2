// One topology name on Apache Storm and in workers of ours.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/name_taken.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class NameTaken : public testing::Test {
 protected:
  NameTaken() {
    const std::string name = "name-taken-test-" + std::to_string(getpid());
    server_ = embedded::RegistryServer::named(name);
    RegistryOptions options;
    options.url = "embedded://" + name;
    registry_ = make_registry(options);
  }
  /// A worker that reads a channel for topology "t", in the group that is given.
  GuardPtr reader(const std::string& engine, const std::string& group = "t", const std::string& topology = "t") {
    ReaderRecord reader;
    reader.topology = TopologyName(topology);
    reader.engine = engine;
    return registry_->hold(paths_.readers(group, "d"_driver, "up") + "/members/w1", encode(reader));
  }
  std::string by_storm() { return taken_by_storm(*registry_, paths_, "t"_topology); }
  std::string by_workers() { return taken_by_workers(*registry_, paths_, "t"_topology); }

  const Paths paths_;
  std::shared_ptr<embedded::RegistryServer> server_;
  std::unique_ptr<Registry> registry_;
};

TEST_F(NameTaken, ByStormWhileItsWorkersRead) {
  EXPECT_EQ(by_storm(), "");
  auto held = reader(engine_storm);
  EXPECT_THAT(by_storm(), AllOf(HasSubstr("Apache Storm runs a topology t already"),
                                HasSubstr("its worker w1 reads channel up of driver d"),
                                HasSubstr("iotcloud topology kill t --engine storm")));
  EXPECT_EQ(by_workers(), "") << "it may be submitted to Storm again, whose Nimbus says what it has";
  held.reset();
  EXPECT_EQ(by_storm(), "");
}

TEST_F(NameTaken, ByStormAlsoWhenItReadsInAGroupOfAnotherName) {
  const auto held = reader(engine_storm, "robots");
  EXPECT_THAT(by_storm(), HasSubstr("w1"));
}

TEST_F(NameTaken, ByNoOtherTopologyAndByNoWorkerThatIsNotStorms) {
  const auto other = reader(engine_storm, "a", "another"), ours = reader(engine_workers, "b"), older = reader("", "c");
  const auto unreadable = registry_->hold(paths_.readers("e", "d"_driver, "up") + "/members/w2", "no record");
  EXPECT_EQ(by_storm(), "");
}

TEST_F(NameTaken, ByAWorkerOfOurs) {
  EXPECT_EQ(by_workers(), "");
  WorkerRecord worker;
  worker.name = "w7";
  worker.host = "lab1";
  auto held = registry_->hold(paths_.workers("t"_topology) + "/w7", encode(worker));
  EXPECT_THAT(by_workers(), AllOf(HasSubstr("workers of ours run a topology t already (worker w7 on lab1)"),
                                  HasSubstr("`iotcloud topology kill t`")));
  held.reset();
  EXPECT_EQ(by_workers(), "");
}

TEST_F(NameTaken, ByASubmissionUntilItIsKilled) {
  Submission submission;
  submission.name = "t"_topology;
  submission.version = {1, "yaml", {}, "digest"};
  put(*registry_, paths_.submission("t"_topology), encode(submission));
  EXPECT_THAT(by_workers(), HasSubstr("it is submitted to the pools"));
  submission.killed = true;
  put(*registry_, paths_.submission("t"_topology), encode(submission));
  EXPECT_EQ(by_workers(), "");
}

}  // namespace
}  // namespace iotcloud::discovery
