// Leader election on every registry.
#include <atomic>
#include <future>

#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

/// One process that stands for election, on its own session.
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
  /// Stands, and waits until the candidacy is visible, so that the order is certain.
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

TEST_P(ElectionContract, AFormerLeaderCannotWriteWhenAnotherOneLeads) {
  const auto first = stand("first");
  const auto second = stand("second");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  EXPECT_FALSE(second->election->lead());
  const auto lead = first->election->lead();
  ASSERT_TRUE(lead);
  EXPECT_EQ(lead->epoch, first->epoch);
  registry_->create("/order", "of the first", true, lead->fence);

  place_->expire(registry_->get(lead->fence.path)->owner_session);
  ASSERT_TRUE(eventually([&] { return second->election->leading(); }));
  EXPECT_EQ(code_of([&] { registry_->set("/order", "late", -1, lead->fence); }), RegistryErrorCode::fenced);
  registry_->set("/order", "of the second", -1, second->election->lead()->fence);
  EXPECT_EQ(registry_->get("/order")->data, "of the second");
  ASSERT_TRUE(history_.wait([](const auto& all) { return testing::Value(all, testing::Contains("first lost")); }));
  EXPECT_FALSE(first->election->lead());
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
  std::atomic<bool> doubted = false;
  const GuardPtr listening = member->registry->on_session([&](SessionState state) {
    if (state == SessionState::expired) doubted = true;
  });
  place_->stop();
  place_->start();
  ASSERT_TRUE(eventually([&] { return member->registry->session() == SessionState::connected; }));
  member->registry->get("/");
  if (!doubted) {
    EXPECT_THAT(history_.all(), testing::ElementsAre("it elected"));
    return;
  }
  // A ZooKeeper that is asked while it starts may never answer. The client's library then waits for two thirds of the
  // session's time before it asks again, and a third is enough to doubt the session.
  ASSERT_TRUE(history_.wait_for_count(3));
  EXPECT_THAT(history_.all(), testing::ElementsAre("it elected", "it lost", "it elected"));
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

/// Elections in which the first candidate leads.
class SeatContract : public RegistryContract {
 protected:
  std::unique_ptr<Election> stand(Registry& registry, const std::string& name) {
    Election::Callbacks callbacks;
    callbacks.on_elected = [this, name](std::int64_t epoch) {
      EXPECT_GT(epoch, last_epoch_.exchange(epoch)) << name;
      history_.add(name + " elected");
    };
    callbacks.on_lost = [this, name] { history_.add(name + " lost"); };
    return std::make_unique<Election>(registry, "/seats/it", name, std::move(callbacks), Succession::whoever_is_first);
  }
  std::int64_t holder() { return registry_->get("/seats/it")->owner_session; }

  std::atomic<std::int64_t> last_epoch_{0};
  Seen<std::string> history_;
};

TEST_P(SeatContract, OneLeadsAndTheOtherFollowsWhenItResigns) {
  auto first = stand(*registry_, "first");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  const auto second = stand(*other_, "second");
  EXPECT_EQ(second->leader_data(), "first");
  first.reset();
  ASSERT_TRUE(history_.wait_for_last("second elected"));
  EXPECT_TRUE(second->leading());
  EXPECT_FALSE(second->lead()) << "its node is no fence";
  EXPECT_EQ(second->leader_data(), "second");
  EXPECT_THAT(history_.all(), testing::ElementsAre("first elected", "second elected"));
}

TEST_P(SeatContract, NothingStaysBehindButTheNodeAbove) {
  auto only = stand(*registry_, "only");
  ASSERT_TRUE(history_.wait_for_last("only elected"));
  only.reset();
  EXPECT_TRUE(registry_->children("/seats")->empty());
}

TEST_P(SeatContract, WhenALeadersSessionExpiresOnlyOneOfThemLeadsNext) {
  const auto first = stand(*registry_, "first");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  const auto second = stand(*other_, "second");
  place_->expire(holder());
  ASSERT_TRUE(history_.wait_for_count(3));
  EXPECT_TRUE(eventually([&] { return first->leading() != second->leading(); }));
  EXPECT_EQ(first->leader_data(), first->leading() ? "first" : "second");
}

TEST_P(SeatContract, OutOfContactForTooLongALeaderLosesAndLeadsAgainWhenItsNodeSurvived) {
  const auto session = client(std::chrono::milliseconds(1500));
  const auto only = stand(*session, "only");
  ASSERT_TRUE(history_.wait_for_last("only elected"));
  last_epoch_ = 0;  // the same candidate again
  place_->stop();
  ASSERT_TRUE(history_.wait_for_last("only lost"));
  place_->start();
  ASSERT_TRUE(history_.wait_for_last("only elected"));
}

/// A leader whose node an operator removed must not, on its way out, remove that of the next one.
TEST_P(SeatContract, ALeaderWhoseNodeIsRemovedLeavesTheNextOneAlone) {
  auto first = stand(*registry_, "first");
  ASSERT_TRUE(history_.wait_for_last("first elected"));
  const auto second = stand(*other_, "second");
  const auto third = client();
  third->remove("/seats/it");
  // Both want the seat; one has it, and keeps it when the other goes or comes back.
  ASSERT_TRUE(history_.wait_for_count(3));
  ASSERT_TRUE(eventually([&] { return first->leading() != second->leading(); }));
  if (first->leading()) {
    first.reset();
    ASSERT_TRUE(history_.wait_for_last("second elected"));
  } else {
    first.reset();
  }
  const std::size_t count = history_.all().size();
  const std::int64_t owner = holder();
  auto again = stand(*registry_, "again");
  registry_->get("/");  // waits for the election's earlier requests
  EXPECT_EQ(holder(), owner);
  EXPECT_EQ(history_.all().size(), count);
  EXPECT_TRUE(second->leading());
}

TEST_P(SeatContract, AHundredElectionsAtOnceCostOneWriteEach) {
  registry_->create("/seats/before", "");
  const std::int64_t before = registry_->get("/seats/before")->created;
  std::vector<std::unique_ptr<Election>> elections;
  for (int i = 0; i < 100; ++i) {
    Election::Callbacks callbacks;
    callbacks.on_elected = [&](std::int64_t) { history_.add("elected"); };
    elections.push_back(std::make_unique<Election>(*registry_, "/seats/of/many/" + std::to_string(i), "it",
                                                   std::move(callbacks), Succession::whoever_is_first));
  }
  ASSERT_TRUE(history_.wait_for_count(100));
  registry_->create("/seats/after", "");
  // Every write counts, also one that fails: a hundred nodes, and a few for the nodes above them.
  EXPECT_LE(registry_->get("/seats/after")->created - before, 110);
}

INSTANTIATE_TEST_SUITE_P(Registries, SeatContract, testing::Values("embedded", "zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

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
