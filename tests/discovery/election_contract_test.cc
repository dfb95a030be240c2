// Leader election on every registry.
#include <atomic>
#include <future>

#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

/// One process that stands for election, on a session of its own.
struct Member {
  Member(std::unique_ptr<Registry> own_registry, const std::string& name, Seen<std::string>& history)
      : registry(std::move(own_registry)) {
    Election::Callbacks callbacks;
    callbacks.on_elected = [this, name, &history](std::int64_t new_epoch) {
      epoch = new_epoch;
      history.add(name + " elected");
    };
    callbacks.on_lost = [name, &history] { history.add(name + " lost"); };
    election.emplace(*registry, "/elections/of it", name, std::move(callbacks));
  }
  std::unique_ptr<Registry> registry;
  std::atomic<std::int64_t> epoch{0};
  std::optional<Election> election;
};

class ElectionContract : public RegistryContract {
 protected:
  /// Stands and is seen to stand, so that the order is certain.
  std::unique_ptr<Member> stand(const std::string& name,
                                std::chrono::milliseconds session_timeout = std::chrono::seconds(20)) {
    const std::size_t before = registry_->children("/elections/of it").value_or(std::vector<std::string>()).size();
    auto member = std::make_unique<Member>(client(session_timeout), name, history_);
    EXPECT_TRUE(eventually([&] {
      return registry_->children("/elections/of it").value_or(std::vector<std::string>()).size() == before + 1;
    }));
    return member;
  }
  static int leaders(const std::vector<std::unique_ptr<Member>>& members) {
    int count = 0;
    for (const auto& member : members) count += member && member->election->leading() ? 1 : 0;
    return count;
  }
  Seen<std::string> history_;
};

TEST_P(ElectionContract, OfFiveMembersTheLongestStandingLeadsAndTheOthersFollowInOrder) {
  std::vector<std::unique_ptr<Member>> members;
  for (int i = 0; i < 5; ++i) members.push_back(stand(std::to_string(i)));
  std::int64_t last_epoch = 0;
  for (std::size_t i = 0; i < members.size(); ++i) {
    ASSERT_TRUE(history_.wait_for_last(std::to_string(i) + " elected"));
    EXPECT_EQ(leaders(members), 1);
    EXPECT_TRUE(members[i]->election->leading());
    for (std::size_t k = i; k < members.size(); ++k) {
      EXPECT_EQ(members[k]->election->leader_data(), std::to_string(i));
    }
    EXPECT_GT(members[i]->epoch, last_epoch);
    last_epoch = members[i]->epoch;
    if (i % 2 == 0) {
      members[i]->election.reset();  // resigns
      members[i].reset();
    } else {
      members[i].reset();  // ends with its process
    }
  }
  EXPECT_EQ(history_.all().size(), 5U);
}

TEST_P(ElectionContract, AMemberInTheMiddleThatGoesChangesNothing) {
  std::vector<std::unique_ptr<Member>> members;
  for (int i = 0; i < 4; ++i) members.push_back(stand(std::to_string(i)));
  ASSERT_TRUE(history_.wait_for_last("0 elected"));
  members[1].reset();
  members[2].reset();
  EXPECT_EQ(leaders(members), 1);
  members[0].reset();
  ASSERT_TRUE(history_.wait_for_last("3 elected"));
  EXPECT_THAT(history_.all(), testing::ElementsAre("0 elected", "3 elected"));
}

TEST_P(ElectionContract, ALeaderWhoseSessionExpiresIsFollowedAndStandsAgain) {
  const auto first = stand("first");
  const auto second = stand("second");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  const auto names = registry_->children("/elections/of it").value();
  place_->expire(registry_->get("/elections/of it/" + names.front())->owner_session);
  ASSERT_TRUE(history_.wait_for_count(3));
  EXPECT_THAT(history_.all(), testing::UnorderedElementsAre("first elected", "first lost", "second elected"));
  EXPECT_FALSE(first->election->leading());
  EXPECT_GT(second->epoch, first->epoch);
  ASSERT_TRUE(eventually([&] { return registry_->children("/elections/of it")->size() == 2; }));
  second->election.reset();
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  EXPECT_GT(first->epoch, second->epoch);
}

TEST_P(ElectionContract, AloneAgainAfterItsSessionExpiredAMemberLeadsUnderANewEpoch) {
  const auto member = stand("it");
  ASSERT_TRUE(history_.wait_for_last("it elected"));
  const std::int64_t before = member->epoch;
  const auto names = registry_->children("/elections/of it").value();
  place_->expire(registry_->get("/elections/of it/" + names.front())->owner_session);
  ASSERT_TRUE(history_.wait_for_count(3));
  EXPECT_THAT(history_.all(), testing::ElementsAre("it elected", "it lost", "it elected"));
  EXPECT_GT(member->epoch, before);
}

TEST_P(ElectionContract, ALeaderOutOfContactForTooLongLosesAndLeadsAgainWhenItsNodeSurvived) {
  const auto member = stand("it", std::chrono::milliseconds(1500));
  ASSERT_TRUE(history_.wait_for_last("it elected"));
  place_->stop();
  ASSERT_TRUE(history_.wait_for_last("it lost"));
  EXPECT_FALSE(member->election->leading());
  place_->start();
  ASSERT_TRUE(history_.wait_for_last("it elected"));
  EXPECT_TRUE(member->election->leading());
}

TEST_P(ElectionContract, AShortInterruptionLosesNoLeader) {
  const auto member = stand("it", std::chrono::seconds(60));
  ASSERT_TRUE(history_.wait_for_last("it elected"));
  place_->stop();
  place_->start();
  ASSERT_TRUE(eventually([&] { return member->registry->session() == SessionState::connected; }));
  member->registry->get("/");
  EXPECT_THAT(history_.all(), testing::ElementsAre("it elected"));
}

TEST_P(ElectionContract, AMemberWhoseNodeIsRemovedStandsAgain) {
  const auto first = stand("first");
  const auto second = stand("second");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  const auto names = registry_->children("/elections/of it").value();
  registry_->remove("/elections/of it/" + names.front());
  ASSERT_TRUE(history_.wait_for_count(3));
  EXPECT_TRUE(eventually([&] { return registry_->children("/elections/of it")->size() == 2; }));
  EXPECT_TRUE(second->election->leading());
}

TEST_P(ElectionContract, MembersThatStandBeforeTheServerIsThereElectOneWhenItComes) {
  place_->stop();
  std::vector<std::unique_ptr<Member>> members;
  for (int i = 0; i < 3; ++i) members.push_back(std::make_unique<Member>(client(), std::to_string(i), history_));
  EXPECT_EQ(leaders(members), 0);
  place_->start();
  ASSERT_TRUE(history_.wait_for_count(1));
  ASSERT_TRUE(eventually([&] { return registry_->children("/elections/of it").value().size() == 3; }));
  EXPECT_EQ(leaders(members), 1);
  EXPECT_EQ(history_.all().size(), 1U);
}

TEST_P(ElectionContract, AnElectionMayEndInItsOwnCallback) {
  std::unique_ptr<Election> election;
  std::promise<void> assigned;
  std::promise<void> ended;
  Election::Callbacks callbacks;
  callbacks.on_elected = [&](std::int64_t) {
    assigned.get_future().wait();
    election.reset();
    ended.set_value();
  };
  election = std::make_unique<Election>(*registry_, "/e", "it", std::move(callbacks));
  assigned.set_value();
  ended.get_future().wait();
  EXPECT_TRUE(eventually([&] { return other_->children("/e")->empty(); }));
}

TEST_P(ElectionContract, ElectionsUnderDifferentPathsAreDifferentElections) {
  const Election here(*registry_, "/here", "one", {});
  const Election there(*other_, "/there", "two", {});
  ASSERT_TRUE(eventually([&] { return here.leading() && there.leading(); }));
  EXPECT_EQ(here.leader_data(), "one");
  EXPECT_EQ(there.leader_data(), "two");
}

INSTANTIATE_TEST_SUITE_P(Registries, ElectionContract, testing::Values("embedded", "zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
