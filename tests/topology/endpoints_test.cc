#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/topology/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/fair_shares.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::topology {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// --- fair shares ---------------------------------------------------------------------------------

std::vector<std::string> names(const std::string& prefix, int count) {
  std::vector<std::string> all;
  for (int i = 0; i < count; ++i) all.push_back(prefix + std::to_string(i));
  return all;
}

TEST(FairShares, GiveEveryWorkerAsMuchOrOneLess) {
  for (const int units : {0, 1, 3, 4, 10, 101}) {
    for (const int workers : {1, 2, 3, 7}) {
      std::map<std::string, int> load;
      for (const auto& worker : names("w", workers)) load[worker] = 0;
      for (const auto& [unit, worker] : fair_shares(names("u", units), names("w", workers))) ++load[worker];
      const auto [least, most] =
          std::minmax_element(load.begin(), load.end(), [](auto& a, auto& b) { return a.second < b.second; });
      EXPECT_LE(most->second - least->second, 1) << units << " units, " << workers << " workers";
    }
  }
}

TEST(FairShares, AreTheSameWhateverTheOrderOfTheNames) {
  auto units = names("u", 50), workers = names("w", 4);
  const auto shares = fair_shares(units, workers);
  std::reverse(units.begin(), units.end());
  std::reverse(workers.begin(), workers.end());
  EXPECT_EQ(fair_shares(units, workers), shares);
}

TEST(FairShares, MoveFewUnitsWhenAWorkerComes) {
  const auto before = fair_shares(names("u", 1000), names("w", 4));
  const auto after = fair_shares(names("u", 1000), names("w", 5));
  int moved = 0;
  for (const auto& [unit, worker] : before) moved += after.at(unit) != worker;
  EXPECT_GE(moved, 200);  // the new one's share
  EXPECT_LT(moved, 400);
}

// --- a worker on embedded broker and registry ------------------------------------------------------

TEST_F(Endpoints, CarryPayloadDriverAndTimeFromTheMessageInToTheMessageOut) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("hello", "one", 1234));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(mailbox.message(0).payload.text(), "hello");
  EXPECT_EQ(mailbox.message(0).driver_id, "one");
  EXPECT_EQ(mailbox.message(0).time_ms, 1234);
  EXPECT_EQ(mailbox.message(0).gateway_id, "g");
}

TEST_F(Endpoints, TakeTheDriverFromTheChannelWhenTheMessageDoesNotNameIt) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("hello", ""));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(mailbox.message(0).driver_id, "one");
}

TEST_F(Endpoints, LeaveWhatASlowTopologyCannotTakeInTheBroker) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run("{prefetchCount: 10}");
  show_driver("one");
  Gate::set(false);
  const auto publisher = device("one");
  for (int i = 0; i < 1000; ++i) publisher->publish(message(std::to_string(i), "one"));
  ASSERT_TRUE(eventually([] {
    const std::lock_guard lock(Gate::mutex);
    return Gate::inside > 0;
  }));
  EXPECT_LE(metric("iotcloud_spout_received_total"), 10);
  EXPECT_EQ(brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t"), 1000U);
  Gate::set(true);
  ASSERT_TRUE(mailbox.wait_for(1000));
  const auto texts = mailbox.texts();
  for (int i = 0; i < 1000; ++i) ASSERT_EQ(texts[static_cast<std::size_t>(i)], std::to_string(i));
  EXPECT_TRUE(eventually(
      [&] { return brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t") == 0; }));
}

TEST_F(Endpoints, FinishWhatIsUnderWayWhenTheWorkerStops) {
  run();
  show_driver("one");
  Gate::set(false);
  const auto publisher = device("one");
  publisher->publish(message("unfinished", "one"));
  ASSERT_TRUE(eventually([] {
    const std::lock_guard lock(Gate::mutex);
    return Gate::inside > 0;
  }));
  std::thread opener([&] {
    // Whether the stop has begun or not: what the bolt has in hand is not settled before it is done.
    EXPECT_EQ(brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t"), 1U);
    Gate::set(true);
  });
  workers_.back()->stop(std::chrono::seconds(5));
  opener.join();
  EXPECT_EQ(brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t"), 0U);
}

TEST_F(Endpoints, CountTuplesForDriversThatAreNotThereAndGoOn) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("lost", "nobody"));
  publisher->publish(message("found", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("found"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_bolt_unknown_driver_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);  // acked by default
}

TEST_F(Endpoints, HoldADriversFirstMessageUntilItsChannelIsKnown) {
  Mailbox mailbox(*broker_, topic("late", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("early", "late"));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_received_total") == 1; }));
  show_driver("late");
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("early"));
}

TEST_F(Endpoints, RejectWhatFailsForGoodWhenTheDriverIsUnknownAndThePolicySaysFail) {
  run("{requeue: false}", "{unknownDriver: fail}");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("lost", "nobody"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_rejected_total") == 1; }));
}

TEST_F(Endpoints, IgnoreChannelsOfAnotherBroker) {
  run();
  show_driver("other", "kafka");
  show_driver("one");
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
}

TEST_F(Endpoints, DropAChannelWhenItsDriverGoes) {
  run();
  show_driver("one");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  discovery::remove_tree(*registry_, paths_.instance("d", "one"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
}

TEST_F(Endpoints, ReadOnWhenTheBrokerWasGoneForAWhile) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("before", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  auto server = brokers::embedded::Server::named(url_.substr(11));
  server.stop();
  publisher->publish(message("meanwhile", "one"));
  server.start();
  ASSERT_TRUE(mailbox.wait_for(2));
  EXPECT_EQ(mailbox.texts().back(), "meanwhile");
}

TEST_F(Endpoints, ReadOnWhileTheRegistryIsAwayAndAfterItsSessionExpired) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("before", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));

  const auto server = discovery::embedded::Server::named(url_.substr(11));
  const auto session = server->sessions().at(0);
  server->stop();
  ASSERT_TRUE(eventually([&] { return registry_->session() == discovery::SessionState::expired; }));
  publisher->publish(message("while it is away", "one"));
  ASSERT_TRUE(mailbox.wait_for(2));

  server->expire(session);
  server->start();
  ASSERT_TRUE(eventually([&] { return registry_->session() == discovery::SessionState::connected; }));
  publisher->publish(message("when it is back", "one"));
  ASSERT_TRUE(eventually([&] {
    const auto texts = mailbox.texts();
    return !texts.empty() && texts.back() == "when it is back";
  }));
}

TEST_F(Endpoints, StartWithoutTheRegistryAndWorkWhenItComes) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  const auto server = discovery::embedded::Server::named(url_.substr(11));
  server->stop();
  run();
  server->start();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("hello", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
}

TEST_F(Endpoints, LetTwoTopologiesGetEverything) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  const std::string yaml =
      "topology.name: other\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time], "
      "builder: text}\nbolts:\n  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], "
      "inputs: {from: in}}\n";
  WorkerOptions options{.definition = TopologyDefinition::parse(yaml, "other.yaml"),
                        .components = {},
                        .library_folders = {},
                        .registry = registry_.get(),
                        .clock = nullptr,
                        .metrics = &metrics_};
  Worker other(std::move(options));
  other.start();
  show_driver("one");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; }));
  const auto publisher = device("one");
  publisher->publish(message("twice", "one"));
  ASSERT_TRUE(mailbox.wait_for(2));
  EXPECT_THAT(mailbox.texts(), ElementsAre("twice", "twice"));
}

TEST_F(Endpoints, RefuseASecondWorkerWhereTuplesOfSeveralDriversAreToMeetUnlessTheFileSaysWorkerScope) {
  const auto yaml = [](const std::string& scope) {
    return "topology.name: t\nregistry.session_timeout: 400ms\nspouts:\n"
           "  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time], builder: text}\nbolts:\n"
           "  gate: {class: Gate, inputs: {from: in, grouping: global}" +
           scope + "}\n";
  };
  ComponentRegistry components;
  components.add_bolt<GateBolt>("Gate");
  run_yaml(yaml(""), components);
  try {
    run_yaml(yaml(""), components);
    FAIL() << "two workers run";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("another worker runs"), HasSubstr("gate <- in, global"), HasSubstr("scope: worker")));
  }
  workers_.clear();
  run_yaml(yaml(", scope: worker"), components);
  run_yaml(yaml(", scope: worker"), components);
}

TEST_F(Endpoints, RefuseAWorkerWithoutRegistry) {
  WorkerOptions options{
      .definition = TopologyDefinition::parse(
          "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [f]}\n", "t.yaml"),
      .components = {},
      .library_folders = {},
      .registry = nullptr,
      .clock = nullptr,
      .metrics = nullptr};
  try {
    Worker worker(std::move(options));
    FAIL() << "it was taken";
  } catch (const config::ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("zk.servers"));
  }
}

}  // namespace
}  // namespace iotcloud::topology
