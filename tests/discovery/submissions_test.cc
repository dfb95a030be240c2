#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

Submission submission(const std::string& name = "t", int workers = 2) {
  Submission submission;
  submission.name = TopologyName(name);
  submission.workers = workers;
  submission.version = {3, "yaml", {{"../x.so", "x.so", "1234"}}, "digest"};
  submission.previous = {2, "before", {}, ""};
  submission.last_number = 3;
  submission.pending = 1;
  return submission;
}

class SubmissionsTest : public testing::Test {
 protected:
  SubmissionsTest() {
    name_ = "submissions-test-" + std::to_string(getpid());
    server_ = embedded::RegistryServer::named(name_);
    RegistryOptions options;
    options.url = "embedded://" + name_;
    registry_ = make_registry(options);
  }
  void put_submission(const Submission& submission) {
    put(*registry_, paths_.submission(submission.name), encode(submission));
  }

  const Paths paths_;
  std::string name_;
  std::shared_ptr<embedded::RegistryServer> server_;
  std::unique_ptr<Registry> registry_;
};

TEST_F(SubmissionsTest, AreReadAsTheyWereWritten) {
  EXPECT_EQ(decode_submission(encode(submission()), "p"), submission());
  PoolRecord pool;
  pool.id = PoolId("p1");
  pool.host = "h";
  pool.port = 1;
  pool.files = {"1234"};
  pool.places = {{"t"_topology, 1, {}, 3, "running", "", "w", 5}};
  EXPECT_EQ(decode_pool(encode(pool), "p"), pool);
}

TEST_F(SubmissionsTest, WithNumbersThatCannotBeAreRefused) {
  for (const int workers : {0, -1, Submission::most_workers + 1}) {
    EXPECT_THROW(decode_submission(encode(submission("t", workers)), "p"), config::Error) << workers;
  }
  auto negative = submission();
  negative.pending = -1;
  EXPECT_THROW(decode_submission(encode(negative), "p"), config::Error);
}

TEST_F(SubmissionsTest, AreListedAndWhatIsNoneIsPassedOver) {
  put_submission(submission());
  put(*registry_, paths_.submission("bad"_topology), "{}");
  put(*registry_, paths_.submission("moved"_topology), encode(submission("t")));
  put(*registry_, paths_.pool(PoolId("bad")), "x");
  const auto all = list_submissions(*registry_, paths_);
  ASSERT_THAT(all, SizeIs(1));
  EXPECT_EQ(all.at("t"_topology).submission, submission());
  EXPECT_THAT(list_pools(*registry_, paths_), IsEmpty());
  put(*registry_, paths_.place("t"_topology, 1), encode(PlaceHolder{PoolId("p1"), "s"}));
  put(*registry_, paths_.places("t"_topology) + "/one", encode(PlaceHolder{PoolId("p1"), "s"}));
  const auto holders = list_holders(*registry_, paths_, {"t"_topology, "none"_topology});
  ASSERT_THAT(holders, SizeIs(1));
  EXPECT_EQ(holders.at({"t"_topology, 1}).pool, "p1");
}

TEST_F(SubmissionsTest, AreAmongTheTopologiesWithTheirPlacesUntilTheyWereKilled) {
  put_submission(submission());
  PoolRecord pool;
  pool.id = PoolId("p1");
  pool.host = "h";
  pool.port = 1;
  pool.places = {{"t"_topology, 1, {}, 3, "running", "", "w", 5}, {"t"_topology, 0, {}, 3, "starting", "", "", 5}};
  const auto lives = registry_->hold(paths_.pool(pool.id), encode(pool));
  auto topologies = list_topologies(*registry_, paths_);
  ASSERT_THAT(topologies, SizeIs(1));
  EXPECT_EQ(topologies[0].version, 3);
  EXPECT_EQ(topologies[0].wanted_workers, 2);
  ASSERT_THAT(topologies[0].places, SizeIs(2));
  EXPECT_EQ(topologies[0].places[0].place, 0);
  EXPECT_EQ(topologies[0].places[1].pool, "p1");
  auto killed = submission();
  killed.killed = true;
  put_submission(killed);
  registry_->set(paths_.pool(pool.id), encode(PoolRecord{PoolId("p1"), "", "h", 1, false, 0, 0, {}, {}, ""}));
  EXPECT_THAT(list_topologies(*registry_, paths_), IsEmpty());
}

TEST_F(SubmissionsTest, LeaveTheirMarkAndTheirHistoryWhenTheirTopologyIsRemoved) {
  TopologyRecord record;
  record.name = "t"_topology;
  put(*registry_, paths_.topology("t"_topology), encode(record));
  put(*registry_, paths_.topology_order("t"_topology), encode(TopologyOrder{}));
  put(*registry_, paths_.topology_history("t"_topology), encode(TopologyHistory{}));
  auto killed = submission();
  killed.killed = true;
  put_submission(killed);
  EXPECT_TRUE(remove_topology(*registry_, paths_, "t"_topology));
  EXPECT_EQ(registry_->get(paths_.topology("t"_topology)), std::nullopt);
  EXPECT_THAT(*registry_->children(paths_.submissions + "/t"), testing::UnorderedElementsAre("history", "wanted"));
  EXPECT_THAT(list_topologies(*registry_, paths_), IsEmpty());
}

TEST(SubmissionRights, OnlyMastersSubmitAndPoolsKeepTheirOwnRecords) {
  const Paths paths;
  const RegistryAccess access({{RegistryUser::Role::master, "m", "d"},
                               {RegistryUser::Role::worker, "w", "d"},
                               {RegistryUser::Role::gateway, "g", "d"}},
                              paths);
  const auto rights = [&](const std::string& path, const std::string& user) {
    for (const auto& grant : access.grants(path, "m")) {
      if (grant.id == user + ":d") return grant.rights;
    }
    return 0;
  };
  EXPECT_EQ(rights(paths.submission("t"_topology), "m"), RegistryAccess::all);
  EXPECT_EQ(rights(paths.submission("t"_topology), "w"), RegistryAccess::read);
  EXPECT_EQ(rights(paths.topology_history("t"_topology), "w"), RegistryAccess::read);
  // Who may create and remove is said by the node above.
  EXPECT_EQ(rights(paths.submissions, "w"), RegistryAccess::read);
  EXPECT_EQ(rights(paths.submissions + "/t", "w"), RegistryAccess::read);
  EXPECT_EQ(rights(paths.topology("wanted"_topology), "w"), RegistryAccess::all);
  EXPECT_EQ(rights(paths.topology_order("t"_topology), "w"), RegistryAccess::read);
  EXPECT_EQ(rights(paths.place("t"_topology, 0), "w"), RegistryAccess::all);
  EXPECT_EQ(rights(paths.pool(PoolId("p1")), "w"), RegistryAccess::all);
  EXPECT_EQ(rights(paths.pool(PoolId("p1")), "g"), RegistryAccess::read);
}

}  // namespace
}  // namespace iotcloud::discovery
