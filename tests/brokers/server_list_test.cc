#include "iotcloud/brokers/client/server_list.h"

#include <gtest/gtest.h>

namespace iotcloud::brokers::client {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

const ServerList::Instant start = ServerList::Instant() + seconds(1000);

TEST(ServerListTest, BeginsWithThePreferredServer) {
  const ServerList servers(3);
  EXPECT_EQ(servers.due(start), 0U);
  EXPECT_LE(servers.next_attempt(), start);
}

TEST(ServerListTest, GoesOnToTheOthersInTurnWithoutWaiting) {
  ServerList servers(3);
  servers.failed(0, start);
  EXPECT_EQ(servers.due(start), 1U);
  servers.failed(1, start);
  EXPECT_EQ(servers.due(start), 2U);
  servers.failed(2, start);
  EXPECT_FALSE(servers.due(start)) << "each has its back-off";
  EXPECT_GT(servers.next_attempt(), start);
  EXPECT_LE(servers.next_attempt(), start + milliseconds(50));
  EXPECT_TRUE(servers.due(servers.next_attempt()));
}

TEST(ServerListTest, TriesThePreferredServerFirstWheneverItIsDue) {
  ServerList servers(2);
  servers.failed(0, start);
  servers.failed(1, start);
  EXPECT_EQ(servers.due(start + seconds(1)), 0U);
}

TEST(ServerListTest, WaitsLongerForAServerThatFailsAgainAndAgain) {
  ServerList servers(1);
  ServerList::Instant now = start;
  for (int i = 0; i < 20; ++i) {
    servers.failed(0, now);
    EXPECT_LE(servers.next_attempt() - now, seconds(2));
    now = servers.next_attempt();
  }
  servers.failed(0, now);
  EXPECT_GE(servers.next_attempt() - now, seconds(1));
  servers.connected(0, now);
  servers.lost(now + seconds(10));
  EXPECT_LE(servers.next_attempt() - now - seconds(10), milliseconds(50)) << "it was good for a while";
}

TEST(ServerListTest, AConnectionThatBreaksAtOnceIsAFailureToo) {
  ServerList servers(1);
  ServerList::Instant now = start;
  for (int i = 0; i < 20; ++i) {
    servers.connected(0, now);
    servers.lost(now);
    now = servers.next_attempt();
  }
  servers.connected(0, now);
  servers.lost(now);
  EXPECT_GE(servers.next_attempt() - now, seconds(1));
}

TEST(ServerListTest, AfterALostConnectionAnotherServerIsDueAtOnce) {
  ServerList servers(2);
  servers.connected(0, start);
  servers.lost(start + seconds(10));
  EXPECT_EQ(servers.due(start + seconds(10)), 1U);
  EXPECT_FALSE(servers.current());
}

TEST(ServerListTest, MovesBackWhenThePreferredServerHasAnsweredForAWhile) {
  ServerList servers(2);
  servers.failed(0, start);
  servers.connected(1, start);
  EXPECT_EQ(servers.current(), 1U);
  EXPECT_FALSE(servers.must_ask(start));
  ServerList::Instant now = start + seconds(1);
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(servers.must_ask(now));
    servers.asked(true, now);
    EXPECT_FALSE(servers.must_ask(now));
    EXPECT_FALSE(servers.must_move_back(now));
    now += seconds(1);
  }
  now = start + seconds(10);
  servers.asked(true, now);
  EXPECT_TRUE(servers.must_move_back(now));
  servers.left();
  EXPECT_EQ(servers.due(now), 0U);
}

TEST(ServerListTest, AMissedAnswerStartsTheWaitAnew) {
  ServerList servers(2);
  servers.connected(1, start);
  servers.asked(true, start);
  servers.asked(false, start + seconds(9));
  servers.asked(true, start + seconds(10));
  EXPECT_FALSE(servers.must_move_back(start + seconds(14)));
  EXPECT_TRUE(servers.must_move_back(start + seconds(20)));
}

TEST(ServerListTest, OnThePreferredServerNothingIsAskedAndNobodyMoves) {
  ServerList servers(2);
  servers.connected(0, start);
  EXPECT_FALSE(servers.must_ask(start + seconds(100)));
  servers.asked(true, start);
  EXPECT_FALSE(servers.must_move_back(start + seconds(100)));
}

}  // namespace
}  // namespace iotcloud::brokers::client
