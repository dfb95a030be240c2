#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <functional>
#include <mutex>
#include <regex>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/tests/topology/endpoints/false_broker.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::topology {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

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

TEST_F(Endpoints, SendTheirCredentialsToTheAddressesOfTheirOwnFileWhateverARecordSays) {
  ::setenv("IOTCLOUD_TEST_PASSWORD", "s3cret", 1);
  const FalseBroker meant;
  const FalseBroker thief;
  broker_url_ = thief.url();
  const auto yaml = [](const std::string& urls) {
    return "topology.name: t\nbrokers:\n  rabbitmq: {" + urls +
           "user: robot, password_variable: IOTCLOUD_TEST_PASSWORD}\nspouts:\n  in:\n    broker: rabbitmq\n"
           "    driver: d\n    channel: up\n    fields: [text, driverID, time]\nbolts:\n  out:\n    broker: rabbitmq\n"
           "    driver: d\n    channel: down\n    fields: [text, driverID, time]\n    inputs: {from: in}\n";
  };
  EXPECT_THROW(run_yaml(yaml(""), {}), config::ConfigError) << "they would go where the record says";
  run_yaml(yaml("urls: [\"" + meant.url() + "\"], "), {});
  show_driver("one");
  EXPECT_TRUE(eventually([&] { return meant.heard().find("s3cret") != std::string::npos; }));
  EXPECT_EQ(thief.heard(), "");
}

TEST_F(Endpoints, LeaveWhatASlowTopologyCannotTakeInTheBroker) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run("{prefetchCount: 10}");
  show_driver("one");
  Gate::set(false);
  const auto publisher = device("one");
  for (int i = 0; i < 1000; ++i) publisher->publish(message(std::to_string(i), "one"));
  ASSERT_TRUE(Gate::wait_for_one());
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
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  Gate::set(false);
  const auto publisher = device("one");
  publisher->publish(message("unfinished", "one"));
  ASSERT_TRUE(Gate::wait_for_one());
  std::thread opener([&] {
    // Whether the stop has begun or not: what the bolt has in hand is not settled before it is done.
    EXPECT_EQ(brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t"), 1U);
    Gate::set(true);
  });
  workers_.back()->stop(tests::patience);
  opener.join();
  EXPECT_EQ(brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t"), 0U);
}

TEST_F(Endpoints, SayWhichChannelsThereAreWhenNoInstanceHasTheOneThatASpoutNames) {
  const tests::CapturedLog log;
  ComponentRegistry components;
  components.add_bolt<GateBolt>("Gate");
  run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: temprature, fields: [text, driverID, "
      "time]}\n"
      "bolts:\n  gate: {class: Gate, inputs: {from: in}}\n",
      std::move(components));
  discovery::DriverRecord driver = driver_record("one");
  for (const auto& [name, direction] :
       {std::pair("wind", discovery::Direction::out), std::pair("temperature", discovery::Direction::out),
        std::pair("control", discovery::Direction::in)}) {
    discovery::ChannelRecord channel;
    channel.name = name;
    channel.direction = direction;
    driver.channels.push_back(channel);
  }
  discovery::put(*registry_, paths_.instance("d"_driver, "one"_instance), discovery::encode(driver));
  EXPECT_TRUE(eventually([&] { return log.contains("did you mean"); }));
  EXPECT_THAT(log.text(),
              testing::HasSubstr("in: waits for the channel \"temprature\", which no active instance of the driver d "
                                 "has; their outgoing channels are \"temperature\", \"wind\"; did you mean "
                                 "\"temperature\"?"));
}

/// Acks nothing until the topology ends, as a long window does.
class WindowLikeBolt : public Bolt {
 public:
  void prepare(const Config&, const TopologyContext&, OutputCollector&) override {}
  void execute(const Tuple& tuple) override {
    kept_.push_back(tuple);
    ++kept;
  }
  void cleanup() override { kept_.clear(); }
  std::chrono::microseconds holds_tuples_for(const Config&) const override { return std::chrono::seconds(20); }

  static inline std::atomic<int> kept{0};  ///< by all objects

 private:
  std::vector<Tuple> kept_;
};

ComponentRegistry window_like() {
  ComponentRegistry components;
  components.add_bolt<WindowLikeBolt>("Window");
  return components;
}
std::string window_behind_spout(const std::string& more_of_the_spout) {
  return "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time]" +
         more_of_the_spout + "}\nbolts:\n  mean: {class: Window, inputs: {from: in}}\n";
}

TEST_F(Endpoints, GiveAWindowAllThatComesInItsTimeThoughItKeepsMoreThanTheUsualPrefetch) {
  WindowLikeBolt::kept = 0;
  run_yaml(window_behind_spout(""), window_like());
  show_driver("one");
  const auto publisher = device("one");
  constexpr int in_ten_seconds = 500;  // at 50 a second, as a window of 10 s keeps them
  for (int i = 0; i < in_ten_seconds; ++i) publisher->publish(message("m", "one"));
  EXPECT_TRUE(eventually([] { return WindowLikeBolt::kept == in_ten_seconds; })) << WindowLikeBolt::kept;
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_prefetch") >= in_ten_seconds; }));
}

/// As a window of so many tuples, however long they take to come.
class CountWindowLikeBolt final : public WindowLikeBolt {
 public:
  std::chrono::microseconds holds_tuples_for(const Config&) const override { return until_others_come; }
};

TEST_F(Endpoints, GiveAWindowThatIsCountedInTuplesAsManyAsItNeeds) {
  WindowLikeBolt::kept = 0;
  ComponentRegistry components;
  components.add_bolt<CountWindowLikeBolt>("Window");
  run_yaml(window_behind_spout(""), std::move(components));
  show_driver("one");
  const auto publisher = device("one");
  constexpr int of_one_window = 500;
  for (int i = 0; i < of_one_window; ++i) publisher->publish(message("m", "one"));
  EXPECT_TRUE(eventually([] { return WindowLikeBolt::kept == of_one_window; })) << WindowLikeBolt::kept;
}

TEST_F(Endpoints, SayInTheWorkersRecordWhichBrokerIsAwayAsLongAsItIs) {
  Worker& worker = run();
  show_driver("one");
  const auto publisher = device("one");
  const auto recorded = [&] {
    const auto workers = discovery::list_workers(*registry_, paths_, discovery::TopologyName("t"));
    return workers.empty() ? std::string("no worker") : workers.front().trouble;
  };
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_broker_away") == 0; }));
  EXPECT_TRUE(eventually([&] { return recorded().empty(); })) << recorded();
  auto server = brokers::embedded::Server::named(broker_url_.substr(broker_url_.find("//") + 2));
  server.stop();
  EXPECT_TRUE(eventually([&] { return recorded().starts_with("the broker rabbitmq (embedded://"); })) << recorded();
  EXPECT_THAT(recorded(), HasSubstr(" is away since 20"));
  EXPECT_EQ(worker.trouble(), recorded());
  EXPECT_THAT(worker.describe(), HasSubstr("\"state\":\"away\""));
  EXPECT_EQ(metric("iotcloud_broker_away"), 1);
  server.start();
  EXPECT_TRUE(eventually([&] { return recorded().empty(); })) << recorded();
  EXPECT_EQ(worker.trouble(), "");
}

TEST_F(Endpoints, SayWhichTopicCannotBeReadAndTryAgain) {
  Worker& worker = run();
  auto channel = channel_record("one", "up", discovery::Direction::out);
  channel.properties = {{"routingKey", "up"}};
  channel.broker_url = "pigeons://loft";
  put_channel(channel);
  put_driver(driver_record("one"));
  EXPECT_TRUE(eventually([&] { return !worker.trouble().empty(); }));
  EXPECT_THAT(worker.trouble(), HasSubstr("in: channel up of driver d: 1 topic(s) cannot be read; every 2 s it is"));
  EXPECT_THAT(worker.trouble(), HasSubstr(topic("one", "up") + ": "));
  EXPECT_THAT(worker.trouble(), HasSubstr("pigeons://loft"));
  channel.broker_url = broker_url_;
  put_channel(channel);
  EXPECT_TRUE(eventually([&] { return worker.trouble().empty(); })) << worker.trouble();
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
}

TEST_F(Endpoints, SayThatThePrefetchIsTheLimitOfAWindowThatKeepsAllMessages) {
  const tests::CapturedLog log;
  run_yaml(window_behind_spout(", properties: {prefetchCount: 5}"), window_like());
  show_driver("one");
  const auto publisher = device("one");
  for (int i = 0; i < 20; ++i) publisher->publish(message("m", "one"));
  EXPECT_TRUE(eventually([&] { return log.contains("is the limit"); }));
  EXPECT_THAT(log.text(), testing::HasSubstr("in: prefetchCount (5) is the limit: of 1 channel(s)"));
  EXPECT_THAT(log.text(), testing::HasSubstr("bolts keep tuples: mean (for up to 20000 ms)"));
  EXPECT_EQ(metric("iotcloud_spout_prefetch_limited"), 1);
}

TEST_F(Endpoints, SayNothingOfChannelsThatAnInstanceLacksOnceAnotherOneHadTheChannel) {
  const tests::CapturedLog log;
  run();
  discovery::DriverRecord other;
  other.name = "d"_driver;
  other.instance = "other"_instance;
  other.gateway = "g"_gateway;
  other.state = discovery::DriverState::active;
  other.channels.emplace_back().name = "wind";
  other.channels.back().direction = discovery::Direction::out;
  discovery::put(*registry_, paths_.instance("d"_driver, "other"_instance), discovery::encode(other));
  show_driver("one");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  show_driver("one", "rabbitmq", discovery::DriverState::inactive);
  // It comes as long after the channel as a warning after the instance that lacks it.
  ASSERT_TRUE(eventually([&] { return log.contains("units taken"); }));
  EXPECT_FALSE(log.contains("they have no outgoing channel")) << "there is one, and it is not known any more";
}

TEST_F(Endpoints, CountTuplesForDriversThatAreNotThereAndGoOn) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("lost@nobody", "one"));
  publisher->publish(message("found", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("found"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_bolt_unknown_driver_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);  // acked by default
}

TEST_F(Endpoints, CountTuplesForADriverThatWentAndSayItOnceWithItsName) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  show_driver("gone");
  const auto publisher = device("one");
  Mailbox reader(*broker_, topic("gone", "down"));
  publisher->publish(message("hello@gone", "one"));
  ASSERT_TRUE(reader.wait_for(1));  // the way to it is known
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "gone"_instance));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  testing::internal::CaptureStderr();
  int sent = 0;
  const auto log = [&] {
    publisher->publish(message("lost@gone", "one"));
    ++sent;
    return metric("iotcloud_bolt_unknown_driver_total") >= 5;
  };
  const bool counted = eventually(log);
  publisher->publish(message("found", "one"));
  const bool found = mailbox.wait_for(1);
  workers_.back()->stop(std::chrono::seconds(5));
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_TRUE(counted && found);
  const std::string line = "there is no driver d with the id \"gone\" and a channel \"down\"";
  ASSERT_NE(said.find(line), std::string::npos) << said;
  EXPECT_EQ(said.find(line), said.rfind(line));
}

TEST_F(Endpoints, SayHowManyUnitsWereTakenNotWhichOnes) {
  testing::internal::CaptureStderr();
  run();
  for (int i = 0; i < 50; ++i) show_driver("i" + std::to_string(i));
  const bool all = eventually([&] { return metric("iotcloud_spout_channels") == 50; });
  std::atomic<bool> told{false};  // behind the line about the last one, which waits a second at most
  const auto later = registry_->after(std::chrono::milliseconds(1100), [&] { told = true; });
  const bool waited = eventually([&] { return told.load(); });
  workers_.clear();
  const std::string said = testing::internal::GetCapturedStderr();
  ASSERT_TRUE(all && waited) << said;
  const std::regex line("in: units taken ([0-9]+), given up 0; [0-9]+ of [0-9]+ are read here\n");
  int taken = 0;
  for (std::sregex_iterator found(said.begin(), said.end(), line), end; found != end; ++found) {
    taken += std::stoi((*found)[1]);
  }
  EXPECT_EQ(taken, 50) << said;
  EXPECT_LT(std::count(said.begin(), said.end(), '\n'), 40) << said;
}

TEST_F(Endpoints, HoldADriversFirstMessageUntilItsChannelIsKnown) {
  Mailbox mailbox(*broker_, topic("late", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("early@late", "one"));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_received_total") == 1; }));
  show_driver("late");
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("early"));
}

TEST_F(Endpoints, RejectWhatFailsForGoodWhenTheDriverIsUnknownAndThePolicySaysFail) {
  run("{requeue: false}", "{unknownDriver: fail}");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("lost@nobody", "one"));
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
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "one"_instance));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
}

class EndpointsOfADriverThatGoes : public Endpoints {
 protected:
  /// The driver "one" goes while most of what it sent is still at the broker.
  void read_to_its_end(const std::function<void()>& go);
};

void EndpointsOfADriverThatGoes::read_to_its_end(const std::function<void()>& go) {
  run("{prefetchCount: 10}");
  show_driver("one");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
  Gate::set(false);
  const auto publisher = device("one");
  for (int i = 0; i < 200; ++i) publisher->publish(message(std::to_string(i), "one"));
  ASSERT_TRUE(publisher->drain(tests::patience));  // the broker has confirmed all
  ASSERT_TRUE(Gate::wait_for_one());
  go();
  show_driver("two");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; })) << "the first is still read";
  Gate::set(true);
  EXPECT_TRUE(eventually(
      [&] { return brokers::embedded::Server::named(url_.substr(11)).depth(topic("one", "up"), "t") == 0; }));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; })) << "only the other driver is read";
}

TEST_F(EndpointsOfADriverThatGoes, ReadWhatItSentBeforeItWasUndeployed) {
  read_to_its_end([&] { discovery::remove_tree(*registry_, paths_.instance("d"_driver, "one"_instance)); });
}

TEST_F(EndpointsOfADriverThatGoes, ReadWhatItSentBeforeItWasStopped) {
  read_to_its_end([&] { show_driver("one", "rabbitmq", discovery::DriverState::inactive); });
}

TEST_F(Endpoints, LeaveNoQueueOfADriverThatIsUndeployedAndThatOfOneThatIsStopped) {
  run();
  show_driver("undeployed");
  show_driver("stopped");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; }));
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "undeployed"_instance));
  show_driver("stopped", "rabbitmq", discovery::DriverState::inactive);
  const auto server = brokers::embedded::Server::named(url_.substr(11));
  EXPECT_TRUE(eventually([&] { return !server.has_queue(topic("undeployed", "up"), "t"); }));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
  EXPECT_TRUE(server.has_queue(topic("stopped", "up"), "t")) << "what it sends when it starts is to wait there";
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "stopped"_instance));
  EXPECT_TRUE(eventually([&] { return !server.has_queue(topic("stopped", "up"), "t"); }));
}

TEST_F(Endpoints, ReadADriverThatComesBackWhileItIsReadToItsEndWithoutAnInterruption) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("before", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  Gate::set(false);
  publisher->publish(message("in hand", "one"));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_received_total") == 2; }));
  show_driver("one", "rabbitmq", discovery::DriverState::starting);
  show_driver("two");
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; }));
  show_driver("one");
  Gate::set(true);
  publisher->publish(message("after", "one"));
  ASSERT_TRUE(mailbox.wait_for(3));
  EXPECT_THAT(mailbox.texts(), ElementsAre("before", "in hand", "after"));
  EXPECT_EQ(metric("iotcloud_broker_redelivered_total"), 0);
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

  const auto server = discovery::embedded::RegistryServer::named(url_.substr(11));
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
  const auto server = discovery::embedded::RegistryServer::named(url_.substr(11));
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
  const tests::CapturedLog log;
  try {
    run_yaml(yaml(""), components);
    FAIL() << "two workers run";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("another worker runs"), HasSubstr("gate <- in, global"), HasSubstr("scope: worker"),
                      HasSubstr("(docs/storm.md): iotcloud topology submit --engine storm")));
  }
  EXPECT_THAT(log.text(), HasSubstr("topology t: another worker holds the place of the only one; this one waits up to "
                                    "2400 ms"));
  workers_.clear();
  run_yaml(yaml(", scope: worker"), components);
  run_yaml(yaml(", scope: worker"), components);
}

TEST_F(Endpoints, AStopEndsTheWaitOfAWorkerThatMustBeTheOnlyOne) {
  const std::string yaml =
      "topology.name: t\nregistry.session_timeout: 120s\nspouts:\n"
      "  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time], builder: text}\nbolts:\n"
      "  gate: {class: Gate, inputs: {from: in, grouping: global}}\n";
  ComponentRegistry components;
  components.add_bolt<GateBolt>("Gate");
  run_yaml(yaml, components);
  std::stop_source stop;
  const tests::CapturedLog log;
  std::jthread asks([&] {
    EXPECT_TRUE(eventually([&] { return log.text().find("this one waits up to") != std::string::npos; }));
    stop.request_stop();
  });
  const Worker& second = run_yaml(yaml, components, stop.get_token());
  EXPECT_TRUE(second.snapshot().tasks.empty()) << "it does not run";
}

TEST_F(Endpoints, RefuseAWorkerOfATopologyThatStormRunsUnderTheSameName) {
  const auto yaml = [](const std::string& session_timeout) {
    return "topology.name: t\nregistry.session_timeout: " + session_timeout +
           "\nspouts:\n"
           "  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time], builder: text}\nbolts:\n"
           "  gate: {class: Gate, inputs: {from: in}}\n";
  };
  ComponentRegistry components;
  components.add_bolt<GateBolt>("Gate");
  discovery::ReaderRecord reader;
  reader.topology = discovery::TopologyName("t");
  reader.engine = discovery::engine_storm;
  auto reads = registry_->hold("/iot/groups/own/d/up/members/slot-1", encode(reader));
  try {
    run_yaml(yaml("400ms"), components);
    FAIL() << "both run";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("t.yaml:1:1: topology.name: Apache Storm runs a topology t already"),
                                    HasSubstr("slot-1 reads channel up of driver d"), HasSubstr("--engine storm")));
  }
  const tests::CapturedLog log;
  std::jthread ends([&] {
    EXPECT_TRUE(eventually([&] { return log.contains("waits for the end of that one"); }));
    reads.reset();
  });
  const Worker& second = run_yaml(yaml("120s"), components);
  EXPECT_FALSE(second.snapshot().tasks.empty()) << "it runs when that one has ended";
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
