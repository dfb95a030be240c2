// Which units a worker runs for, reads, drains and ends: without registry, broker, timers or threads.
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/topology/endpoints/receiving/spout_units.h>

namespace iotcloud::topology {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;
using testing::UnorderedElementsAre;

/// Subscriptions by topic, to which the test delivers.
class HandBroker final : public brokers::Broker {
 public:
  std::unique_ptr<brokers::Publisher> publisher(const brokers::Topic&, const brokers::PublisherOptions&) override {
    return nullptr;
  }
  std::unique_ptr<brokers::Subscription> subscribe(const brokers::Topic& topic, const brokers::SubscriptionOptions&,
                                                   brokers::Handler handler) override {
    ++opened;
    handlers_[topic.name] = std::move(handler);
    return std::make_unique<Reading>(*this, topic.name);
  }
  brokers::ConnectionState state() const override { return brokers::ConnectionState::connected; }
  const std::string& url() const override { return url_; }

  void deliver(const std::string& topic) {
    class Nobody final : public brokers::Settler {
      void settle(std::uint64_t, brokers::Settlement) noexcept override {}
    };
    handlers_.at(topic)(brokers::Delivery({}, false, std::make_shared<Nobody>(), 1));
  }
  std::vector<std::string> topics() const {
    std::vector<std::string> names;
    for (const auto& [name, handler] : handlers_) names.push_back(name);
    return names;
  }

  int opened = 0;                                ///< subscriptions that were ever made
  bool active = true;                            ///< of all subscriptions
  std::map<std::string, std::uint64_t> waiting;  ///< how many messages wait, by topic
  std::vector<std::string> asked;                ///< of which topics somebody asked how many

 private:
  struct Reading final : brokers::Subscription {
    Reading(HandBroker& of, std::string name) : broker(of), topic(std::move(name)) {}
    ~Reading() override { broker.handlers_.erase(topic); }
    Reading(const Reading&) = delete;
    Reading& operator=(const Reading&) = delete;
    void pause() override {}
    void resume() override {}
    bool raise_prefetch(std::uint16_t) override { return false; }
    bool active() const override { return broker.active; }
    std::optional<std::uint64_t> backlog() override {
      broker.asked.push_back(topic);
      const auto found = broker.waiting.find(topic);
      return found == broker.waiting.end() ? std::nullopt : std::optional(found->second);
    }
    HandBroker& broker;
    const std::string topic;
  };
  const std::string url_ = "hand://here";
  std::map<std::string, brokers::Handler> handlers_;
};

class SpoutUnitsTest : public testing::Test {
 protected:
  SpoutUnitsTest()
      : units_({.component = "in",
                .worker = "me",
                .run_for_leader = [this](const std::string& unit) -> discovery::GuardPtr {
                  return std::make_unique<Candidacy>(runs_for_, unit);
                },
                .open_reader =
                    [this](const auto& channel, const auto& topic, auto, int task) {
                      tasks_[channel.instance.str()] = task;
                      if (unreadable_.contains(topic.second.name)) return std::shared_ptr<TopicReader>();
                      return TopicReader::open(broker_, topic.first, topic.second, {},
                                               {channel.gateway, channel.instance}, queue_, fence_,
                                               std::make_shared<HeldMessages>());
                    }}) {
    units_.begin(2);
  }
  ~SpoutUnitsTest() override { units_.close(); }

  void add(const std::string& instance) {
    discovery::ChannelRecord channel;
    channel.instance = discovery::InstanceId(instance);
    channel.gateway = "gateway"_gateway;
    units_.add(instance, channel, topic(instance), std::nullopt);
  }
  static UnitReaders::Key topic(const std::string& instance) {
    return {{"local", {"hand://here"}}, {"", instance, false}};
  }
  void remove(const std::string& instance) {
    units_.remove(instance, discovery::InstanceId(instance), SpoutUnits::End::when_silent);
  }
  /// This worker is alone, has these instances, and leads them all.
  void read_alone(const std::vector<std::string>& instances) {
    units_.set_sharers({{"me", 2}});
    for (const auto& instance : instances) add(instance);
    units_.share_out();
    for (const auto& instance : instances) units_.on_elected(instance);
  }
  /// Looks as often as happens in `time`, or until something has ended.
  std::vector<SpoutUnits::EndedTopic> look(std::chrono::milliseconds time) {
    for (auto passed = SpoutUnits::look_period; passed <= time; passed += SpoutUnits::look_period) {
      if (auto ended = units_.look(); !ended.empty()) return ended;
      units_.take_resigned();
    }
    return {};
  }
  void settle_all() {
    while (queue_->size() > 0) queue_->pop().arrival->delivery.settle(brokers::Settlement::accept);
  }

  struct Candidacy final : discovery::Guard {
    Candidacy(std::set<std::string>& all, std::string name) : units(all), unit(std::move(name)) { units.insert(unit); }
    ~Candidacy() override { units.erase(unit); }
    Candidacy(const Candidacy&) = delete;
    Candidacy& operator=(const Candidacy&) = delete;
    std::set<std::string>& units;
    const std::string unit;
  };

  const std::shared_ptr<HandBroker> broker_ = std::make_shared<HandBroker>();
  const std::shared_ptr<SpoutQueue> queue_ = std::make_shared<SpoutQueue>(100, SpoutWaker());
  const std::shared_ptr<StandstillFence> fence_ = std::make_shared<StandstillFence>();
  std::set<std::string> runs_for_;
  std::set<std::string> unreadable_;  ///< topics that cannot be opened
  std::map<std::string, int> tasks_;  ///< for which a reader was opened last, by instance
  SpoutUnits units_;
};

TEST_F(SpoutUnitsTest, AUnitIsReadWhenItsWorkerLeadsIt) {
  units_.set_sharers({{"me", 2}});
  add("a");
  add("b");
  EXPECT_THAT(runs_for_, UnorderedElementsAre("a", "b"));
  EXPECT_THAT(broker_->topics(), IsEmpty());
  units_.on_elected("b");
  EXPECT_THAT(broker_->topics(), ElementsAre("b"));
  EXPECT_EQ(units_.read_here(), 1U);
  EXPECT_EQ(units_.readers(), 1U);
  EXPECT_EQ(units_.take_changes().taken, 1U);
  units_.on_lost("b", false);
  EXPECT_THAT(broker_->topics(), IsEmpty());
  EXPECT_EQ(units_.take_changes().given_up, 1U);
}

TEST_F(SpoutUnitsTest, NoUnitIsRunForBeforeTheSharersAreKnown) {
  add("a");
  EXPECT_TRUE(units_.needs_sharing());
  units_.share_out();
  EXPECT_THAT(runs_for_, IsEmpty());
  units_.set_sharers({{"me", 2}});
  units_.share_out();
  EXPECT_THAT(runs_for_, ElementsAre("a"));
}

TEST_F(SpoutUnitsTest, TasksReadEvenNumbersOfUnits) {
  read_alone({"a", "b", "c", "d"});
  int of_first = 0;
  for (const auto& [instance, task] : tasks_) of_first += task == 0;
  EXPECT_EQ(of_first, 2);
}

TEST_F(SpoutUnitsTest, AUnitGoesToAnotherWorkerWhenItsMessagesAreSettled) {
  read_alone({"a", "b"});
  broker_->deliver("a");
  broker_->deliver("b");
  units_.set_sharers({{"another", 2}, {"third", 2}});
  units_.share_out();
  look(SpoutUnits::drain_limit / 2);
  EXPECT_THAT(runs_for_, ElementsAre("a", "b"));
  EXPECT_TRUE(units_.needs_look());
  settle_all();
  look(SpoutUnits::look_period);
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_THAT(broker_->topics(), IsEmpty());
  EXPECT_FALSE(units_.needs_look());
}

TEST_F(SpoutUnitsTest, AUnitWhoseMessagesAreNotSettledGoesAtTheLimit) {
  read_alone({"a"});
  broker_->deliver("a");
  units_.set_sharers({{"another", 2}});
  units_.share_out();
  look(SpoutUnits::drain_limit);
  EXPECT_THAT(runs_for_, ElementsAre("a"));
  look(SpoutUnits::look_period);
  EXPECT_THAT(runs_for_, IsEmpty());
}

TEST_F(SpoutUnitsTest, AUnitThatComesBackWhileItIsDrainedIsReadAgain) {
  read_alone({"a"});
  broker_->deliver("a");
  units_.set_sharers({{"another", 2}});
  units_.share_out();
  units_.set_sharers({{"me", 2}});
  units_.share_out();
  settle_all();
  look(SpoutUnits::look_period);
  EXPECT_THAT(runs_for_, ElementsAre("a"));
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
  EXPECT_EQ(broker_->opened, 2) << "the drained reader takes nothing more";
}

TEST_F(SpoutUnitsTest, WhatIsLostWithTheRegistryIsReadUntilItIsBack) {
  read_alone({"a", "b"});
  units_.on_lost("a", true);
  units_.on_lost("b", true);
  units_.set_sharers({{"another", 2}});
  units_.share_out();
  EXPECT_FALSE(units_.needs_look()) << "no unit moves without the registry";
  EXPECT_THAT(broker_->topics(), ElementsAre("a", "b"));
  units_.set_sharers({{"me", 2}});
  units_.on_elected("b");
  units_.registry_back();
  EXPECT_THAT(broker_->topics(), ElementsAre("b"));
  EXPECT_THAT(runs_for_, ElementsAre("a", "b"));
}

TEST_F(SpoutUnitsTest, AUnitWithoutChannelsIsReadUntilNothingComes) {
  read_alone({"a"});
  remove("a");
  EXPECT_EQ(units_.size(), 0U);
  EXPECT_THAT(look(SpoutUnits::end_silence / 2), IsEmpty());
  broker_->deliver("a");
  EXPECT_THAT(look(SpoutUnits::end_silence * 2), IsEmpty()) << "a message is in hand";
  settle_all();
  units_.undeployed("a"_instance);
  const auto ended = look(SpoutUnits::end_silence + SpoutUnits::look_period);  // the first look sees the settlement
  ASSERT_EQ(ended.size(), 1U);
  EXPECT_EQ(ended.front().instance, "a"_instance);
  EXPECT_EQ(ended.front().topic, topic("a"));
  EXPECT_TRUE(ended.front().undeployed);
  units_.take_resigned();
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_THAT(broker_->topics(), IsEmpty());
}

TEST_F(SpoutUnitsTest, AUnitWithoutChannelsWaitsForItsBrokerAndIsReadToItsEndThen) {
  read_alone({"a"});
  remove("a");
  broker_->active = false;
  EXPECT_TRUE(units_.cut_off());
  EXPECT_THAT(look(2 * SpoutUnits::stuck_limit), IsEmpty());
  broker_->active = true;
  broker_->deliver("a");
  settle_all();
  EXPECT_THAT(look(SpoutUnits::end_silence), IsEmpty()) << "the first look has seen that a message came";
  const auto ended = look(SpoutUnits::look_period);
  ASSERT_EQ(ended.size(), 1U);
  EXPECT_FALSE(ended.front().undeployed);
}

TEST_F(SpoutUnitsTest, AUnitWithoutChannelsIsReadForAsLongAsMessagesComeOrAreSettled) {
  read_alone({"a"});
  remove("a");
  for (int i = 0; i < 10; ++i) {
    broker_->deliver("a");
    EXPECT_THAT(look(SpoutUnits::stuck_limit / 2), IsEmpty());
  }
  while (queue_->size() > 0) {
    queue_->pop().arrival->delivery.settle(brokers::Settlement::accept);
    EXPECT_THAT(look(queue_->size() > 0 ? SpoutUnits::stuck_limit / 2 : SpoutUnits::end_silence), IsEmpty());
  }
  EXPECT_THAT(look(SpoutUnits::look_period), SizeIs(1));
}

/// Two drivers stop at once. When the first is gone, the other worker gives the second one's unit to this one, and when
/// the second is gone, too, this worker does not lead the unit yet.
TEST_F(SpoutUnitsTest, AUnitThatEndsOnItsWayFromAnotherWorkerIsReadToItsEndHere) {
  units_.set_sharers({{"me", 2}});
  add("a");
  units_.share_out();
  remove("a");
  EXPECT_THAT(look(SpoutUnits::stuck_limit), IsEmpty());
  EXPECT_THAT(runs_for_, ElementsAre("a"));
  units_.on_elected("a");
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
  broker_->deliver("a");
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty());
  settle_all();
  const auto ended = look(2 * SpoutUnits::end_silence);
  ASSERT_THAT(ended, SizeIs(1));
  EXPECT_EQ(ended[0].instance.str(), "a");
  units_.take_resigned();
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_THAT(broker_->topics(), IsEmpty());
}

/// The driver stops just after this worker gave its unit to another one, which has not run for it yet and forgets it.
TEST_F(SpoutUnitsTest, AUnitThatEndsAfterItWasGivenToAnotherWorkerIsReadToItsEndByWhoeverLeadsIt) {
  read_alone({"a"});
  units_.set_sharers({{"another", 2}});
  units_.share_out();
  look(SpoutUnits::look_period);
  EXPECT_THAT(runs_for_, IsEmpty());
  remove("a");
  EXPECT_THAT(runs_for_, ElementsAre("a"));
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty()) << "if the other one leads it, that one reads it";
  EXPECT_THAT(broker_->topics(), IsEmpty());
  units_.on_elected("a");
  broker_->deliver("a");
  settle_all();
  const auto ended = look(2 * SpoutUnits::end_silence);
  ASSERT_THAT(ended, SizeIs(1));
  EXPECT_EQ(ended[0].instance, "a"_instance);
  units_.take_resigned();
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_THAT(broker_->topics(), IsEmpty());
}

TEST_F(SpoutUnitsTest, AUnitThatWasNeverReadHereIsForgottenWhenItEnds) {
  units_.set_sharers({{"another", 2}});
  add("a");
  units_.share_out();
  remove("a");
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_FALSE(units_.needs_look());
}

TEST_F(SpoutUnitsTest, AUnitThatEndsAndIsNeverLedHereIsNoLongerRunForInTheEnd) {
  units_.set_sharers({{"me", 2}});
  add("a");
  units_.share_out();
  remove("a");
  EXPECT_THAT(look(SpoutUnits::longest_end + SpoutUnits::end_silence), IsEmpty());
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_FALSE(units_.needs_look());
}

TEST_F(SpoutUnitsTest, AnInstanceThatIsBackBeforeItsUnitIsLedHereIsReadAsBefore) {
  units_.set_sharers({{"me", 2}});
  add("a");
  units_.share_out();
  remove("a");
  add("a");
  units_.share_out();
  EXPECT_THAT(units_.take_resigned(), IsEmpty());
  EXPECT_THAT(runs_for_, ElementsAre("a"));
  units_.on_elected("a");
  EXPECT_EQ(units_.read_here(), 1U);
  EXPECT_FALSE(units_.needs_look());
}

TEST_F(SpoutUnitsTest, AUnitWhoseMessagesAreNotSettledIsGivenUpWhenItIsIdleForSoLong) {
  read_alone({"a"});
  broker_->deliver("a");
  remove("a");
  EXPECT_THAT(look(SpoutUnits::stuck_limit - SpoutUnits::look_period), IsEmpty());
  broker_->active = false;
  EXPECT_THAT(look(SpoutUnits::stuck_limit), IsEmpty()) << "nobody could settle it at the broker";
  broker_->active = true;
  EXPECT_THAT(look(SpoutUnits::stuck_limit - SpoutUnits::look_period), IsEmpty());
  EXPECT_THAT(look(SpoutUnits::look_period), SizeIs(1));
}

TEST_F(SpoutUnitsTest, AUnitThatIsNeverIdleIsGivenUpInTheEnd) {
  read_alone({"a"});
  remove("a");
  broker_->active = false;
  EXPECT_THAT(look(SpoutUnits::longest_end), IsEmpty());
  EXPECT_THAT(look(SpoutUnits::look_period), SizeIs(1));
}

TEST_F(SpoutUnitsTest, AUnitWhoseTopicCannotBeOpenedHasNotBeenReadToItsEnd) {
  unreadable_ = {"a"};
  read_alone({"a", "b"});
  EXPECT_EQ(units_.readers(), 1U);
  EXPECT_EQ(units_.missing(), 1U);
  remove("a");
  EXPECT_THAT(look(SpoutUnits::stuck_limit), IsEmpty());
  units_.open_missing();
  EXPECT_EQ(units_.missing(), 1U);
  unreadable_.clear();
  units_.open_missing();
  EXPECT_EQ(units_.missing(), 0U);
  EXPECT_THAT(broker_->topics(), ElementsAre("a", "b"));
  EXPECT_EQ(broker_->opened, 2) << "the other one is open";
  broker_->deliver("a");
  settle_all();
  EXPECT_THAT(look(SpoutUnits::end_silence / 2), IsEmpty());
  EXPECT_THAT(look(SpoutUnits::end_silence), SizeIs(1));
}

TEST_F(SpoutUnitsTest, AUnitWhoseTopicCanNeverBeOpenedIsGivenUpInTheEnd) {
  unreadable_ = {"a"};
  read_alone({"a"});
  remove("a");
  EXPECT_THAT(look(SpoutUnits::longest_end), IsEmpty());
  EXPECT_THAT(look(SpoutUnits::look_period), SizeIs(1));
  EXPECT_EQ(units_.missing(), 0U);
}

TEST_F(SpoutUnitsTest, AnInstanceThatIsBackBeforeTheEndIsReadOnWithoutAPause) {
  read_alone({"a"});
  remove("a");
  look(SpoutUnits::end_silence / 2);
  EXPECT_THAT(units_.ending_instances(), ElementsAre("a"_instance));
  add("a");
  EXPECT_EQ(broker_->opened, 1);
  EXPECT_EQ(units_.read_here(), 1U);
  EXPECT_THAT(look(SpoutUnits::end_silence * 2), IsEmpty());
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
}

TEST_F(SpoutUnitsTest, BrokersAreAskedInTurnHowManyMessagesWait) {
  read_alone({"a", "b", "c"});
  broker_->waiting = {{"a", 5}, {"c", 7}};
  EXPECT_EQ(units_.backlog().known, 0U);
  units_.ask_backlog(2);
  EXPECT_EQ(units_.backlog().messages, 5U);
  units_.ask_backlog(2);
  EXPECT_THAT(broker_->asked, ElementsAre("a", "b", "c", "a"));
  const Backlog all = units_.backlog();
  EXPECT_EQ(all.known, 2U) << "of b nothing is known";
  EXPECT_EQ(all.messages, 12U);
  EXPECT_EQ(all.topic, "c");
  EXPECT_EQ(all.most, 7U);
  broker_->asked.clear();
  units_.ask_backlog(100);
  EXPECT_THAT(broker_->asked, ElementsAre("b", "c", "a")) << "each once";
}

TEST_F(SpoutUnitsTest, AfterTheFenceAllReadersAreOpenedAnew) {
  read_alone({"a", "b"});
  remove("b");
  units_.read_anew();
  EXPECT_THAT(broker_->topics(), ElementsAre("a", "b"))
      << "what its driver sent before it stopped is still at the broker";
  EXPECT_EQ(broker_->opened, 4);
}

TEST_F(SpoutUnitsTest, AfterTheFenceNothingIsReadBeforeItIsKnownWhoLeads) {
  read_alone({"a", "b", "c"});
  remove("c");
  units_.hold_back();
  EXPECT_THAT(broker_->topics(), IsEmpty());
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty()) << "what is not read has not been read to its end";
  units_.on_lost("a", true);
  units_.on_lost("b", true);
  units_.on_elected("b");
  units_.registry_back();
  EXPECT_THAT(broker_->topics(), IsEmpty());
  units_.read_anew();
  EXPECT_THAT(broker_->topics(), ElementsAre("b", "c")) << "another worker leads a";
}

TEST_F(SpoutUnitsTest, AUnitWithoutChannelsThatAnotherWorkerLeadsAfterTheFenceIsNotReadHere) {
  read_alone({"a"});
  remove("a");
  units_.hold_back();
  units_.on_lost("a", true);
  units_.registry_back();
  units_.read_anew();
  EXPECT_THAT(broker_->topics(), IsEmpty());
  EXPECT_THAT(look(SpoutUnits::stuck_limit), IsEmpty()) << "if the other one leads it, that one reads it";
  EXPECT_THAT(runs_for_, ElementsAre("a")) << "the other one may have forgotten it";
  units_.on_elected("a");
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), SizeIs(1));
}

TEST_F(SpoutUnitsTest, AUnitWithoutChannelsIsReadOnWhileTheRegistryIsAwayAndUntilAnotherWorkerMayLeadIt) {
  read_alone({"a", "b", "c"});
  for (const auto* instance : {"a", "b", "c"}) {
    remove(instance);
    broker_->deliver(instance);
  }
  units_.on_lost("a", true);
  units_.on_lost("b", true);
  units_.on_lost("c", false);
  EXPECT_THAT(broker_->topics(), ElementsAre("a", "b"));
  units_.on_elected("b");
  units_.registry_back();
  EXPECT_THAT(broker_->topics(), ElementsAre("b"));
  EXPECT_EQ(broker_->opened, 3) << "nothing interrupted the one that this worker leads again";
}

TEST_F(SpoutUnitsTest, AnInstanceThatIsBackWhileTheRegistryIsAwayIsReadOnUntilAnotherWorkerMayLeadIt) {
  read_alone({"a"});
  remove("a");
  units_.on_lost("a", true);
  add("a");
  EXPECT_EQ(broker_->opened, 1);
  EXPECT_THAT(units_.take_resigned(), IsEmpty());
  units_.registry_back();
  EXPECT_THAT(broker_->topics(), IsEmpty());
  units_.on_elected("a");
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
}

TEST_F(SpoutUnitsTest, AfterTheFenceAUnitWithoutChannelsIsStillReadToItsEnd) {
  read_alone({"a"});
  const int task = tasks_.at("a");
  remove("a");
  broker_->deliver("a");
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty()) << "a message is in hand";
  broker_->active = false;  // until the broker has cut the old reader off
  fence_->raise();
  units_.read_anew();
  EXPECT_EQ(tasks_.at("a"), task);
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty());
  broker_->active = true;
  broker_->deliver("a");  // again, because it was not settled
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), IsEmpty());
  EXPECT_EQ(queue_->size(), 1U);
  settle_all();
  EXPECT_THAT(look(2 * SpoutUnits::end_silence), SizeIs(1));
  units_.take_resigned();
  EXPECT_THAT(runs_for_, IsEmpty());
  EXPECT_THAT(broker_->topics(), IsEmpty());
}

TEST_F(SpoutUnitsTest, AfterTheFenceAUnitThatEndsAndIsNotLedYetStillWaitsForItsElection) {
  units_.set_sharers({{"me", 2}});
  add("a");
  remove("a");
  units_.read_anew();
  EXPECT_THAT(broker_->topics(), IsEmpty());
  units_.on_elected("a");
  EXPECT_THAT(broker_->topics(), ElementsAre("a"));
}

}  // namespace
}  // namespace iotcloud::topology
