// Which pool runs what: the arithmetic alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/pool/views.h>
#include <iotcloud/topology/pool/place_shares.h>

namespace iotcloud::topology {
namespace {

using testing::IsEmpty;
using testing::SizeIs;
using views::hold;
using views::pool;
using views::submission;

std::map<std::string, int> loads(const std::map<discovery::PlaceId, discovery::PoolId>& shared) {
  std::map<std::string, int> loads;
  for (const auto& [place, pool] : shared) ++loads[pool];
  return loads;
}

TEST(PlaceShares, GiveEveryPoolAsManyWorkersOrOneLess) {
  for (const int pools : {1, 2, 3, 5}) {
    for (const int workers : {1, 2, 4, 7}) {
      PoolView view;
      for (int i = 0; i < pools; ++i) view.pools.push_back(pool("p" + std::to_string(i)));
      for (const auto* name : {"a", "b", "c"})
        view.submissions[discovery::TopologyName(name)] = submission(name, workers);
      const auto shared = share_places(view);
      ASSERT_THAT(shared, SizeIs(static_cast<std::size_t>(3 * workers)));
      const int least = 3 * workers / pools;
      for (const auto& one : view.pools) {
        const int load = loads(shared)[one.id];
        EXPECT_TRUE(load == least || load == least + 1) << pools << " pools, " << workers << " workers: " << load;
      }
    }
  }
}

TEST(PlaceShares, SpreadTheWorkersOfOneTopology) {
  PoolView view{{pool("p0"), pool("p1")}, {}, {}};
  for (const auto* name : {"a", "b"}) view.submissions[discovery::TopologyName(name)] = submission(name, 2);
  const auto shared = share_places(view);
  for (const auto* name : {"a", "b"}) {
    EXPECT_NE(shared.at({discovery::TopologyName(name), 0}), shared.at({discovery::TopologyName(name), 1})) << name;
  }
}

TEST(PlaceShares, LeaveWhatIsHeldWhereItIs) {
  PoolView view{{pool("p0"), pool("p1")}, {{discovery::TopologyName("a"), submission("a", 3)}}, {}};
  hold(view, "a", 0, "p1");
  hold(view, "a", 1, "p1");
  hold(view, "a", 2, "p0");
  const auto shared = share_places(view);
  for (const auto& [place, holder] : view.holders) EXPECT_EQ(shared.at(place), holder.pool);
}

TEST(PlaceShares, MoveNoMoreThanItTakesWhenAPoolComes) {
  PoolView view{{pool("p0"), pool("p1")}, {{discovery::TopologyName("a"), submission("a", 4)}}, {}};
  for (int place = 0; place < 4; ++place) hold(view, "a", place, "p0");
  const auto shared = share_places(view);
  EXPECT_EQ(loads(shared), (std::map<std::string, int>{{"p0", 2}, {"p1", 2}}));
  EXPECT_EQ(shared.at({discovery::TopologyName("a"), 0}), discovery::PoolId("p0"));
}

TEST(PlaceShares, GiveWhatALostPoolHeldToTheOthers) {
  PoolView view{{pool("p1")}, {{discovery::TopologyName("a"), submission("a", 2)}}, {}};
  hold(view, "a", 0, "p0");
  hold(view, "a", 1, "p1");
  EXPECT_EQ(loads(share_places(view)), (std::map<std::string, int>{{"p1", 2}}));
}

TEST(PlaceShares, GiveAPoolNoMoreWorkersThanItHasRoomFor) {
  PoolView view{{pool("p0"), pool("p1")}, {{discovery::TopologyName("a"), submission("a", 5)}}, {}};
  view.pools[0].most_workers = 1;
  EXPECT_EQ(loads(share_places(view)), (std::map<std::string, int>{{"p0", 1}, {"p1", 4}}));
  view.pools[1].most_workers = 2;
  EXPECT_THAT(share_places(view), SizeIs(3));
}

TEST(PlaceShares, GiveAPoolNoWorkerWhoseLibraryItLacks) {
  PoolView view{{pool("p0"), pool("p1")}, {{discovery::TopologyName("a"), submission("a", 2)}}, {}};
  view.submissions.begin()->second.version.libraries = {{"a.so", "a.so", "1234"}};
  EXPECT_THAT(share_places(view), IsEmpty());
  view.pools[1].files = {"1234"};
  EXPECT_EQ(loads(share_places(view)), (std::map<std::string, int>{{"p1", 2}}));
}

TEST(PlaceShares, GiveNobodyAKilledTopology) {
  PoolView view{{pool("p0")}, {{discovery::TopologyName("a"), submission("a", 2)}}, {}};
  view.submissions.begin()->second.killed = true;
  EXPECT_THAT(share_places(view), IsEmpty());
}

TEST(PlaceShares, DuringAnUpdateTheLastPlacesRunTheVersionBefore) {
  auto updated = submission("a", 3, 2);
  updated.previous = submission("a", 3, 1).version;
  updated.pending = 2;
  EXPECT_EQ(updated.version_of(0).number, 2);
  EXPECT_EQ(updated.version_of(1).number, 1);
  EXPECT_EQ(updated.version_of(2).number, 1);
}

}  // namespace
}  // namespace iotcloud::topology
