#include <future>
#include <map>
#include <mutex>

#include <gmock/gmock.h>

#include <iotcloud/gateway/host/shared_channels.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {
namespace {

using brokers::Settlement;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Pair;
using namespace std::chrono_literals;

/// What became of deliveries. Thread safe.
class Settlements final : public brokers::Settler {
 public:
  void settle(std::uint64_t tag, Settlement settlement) noexcept override {
    const std::lock_guard lock(mutex_);
    all_[tag] = settlement;
  }
  std::optional<Settlement> of(std::uint64_t tag) const {
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(tag);
    return found == all_.end() ? std::nullopt : std::optional(found->second);
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::uint64_t, Settlement> all_;  ///< guarded by mutex_
};

/// Subscribes for the test, which hands on the messages itself.
class PlayedBroker final : public brokers::Broker {
 public:
  std::unique_ptr<brokers::Publisher> publisher(const brokers::Topic&, const brokers::PublisherOptions&) override {
    return nullptr;
  }
  std::unique_ptr<brokers::Subscription> subscribe(const brokers::Topic&, const brokers::SubscriptionOptions&,
                                                   brokers::Handler given) override {
    handler = std::move(given);
    return std::make_unique<Reading>();
  }
  brokers::ConnectionState state() const override { return brokers::ConnectionState::connected; }
  const std::string& url() const override { return url_; }

  brokers::Handler handler;

 private:
  struct Reading final : brokers::Subscription {
    void pause() override {}
    void resume() override {}
    bool raise_prefetch(std::uint16_t) override { return false; }
    bool active() const override { return true; }
  };
  const std::string url_ = "played://";
};

/// A host with the instance "a", which takes nothing unless told. Its timer stands still unless told.
class SharedChannelsTest : public ::testing::Test {
 protected:
  SharedChannelsTest() {
    timers_->post([go_on = go_on_.get_future().share()] { go_on.wait(); });
    channel_.topic.name = "gw.p.control";
  }
  ~SharedChannelsTest() override {
    let_timers_run();
    timers_->stop();
    driver_->stop();
  }
  /// \param passes whether there is a gateway
  void open(bool passes) {
    Passing passing;
    if (passes) {
      passing.pass = [this](const PassedMessage& message) {
        const std::lock_guard lock(mutex_);
        passed_.push_back(message);
        return not_passed_;
      };
    }
    channels_.emplace(timers_, clock_, metrics_, passing);
    join("a"_instance);
  }
  void let_timers_run() {
    if (!std::exchange(timers_run_, true)) go_on_.set_value();
  }

  /// The instance is opened again.
  void join(const discovery::InstanceId& instance) {
    queues_[instance] =
        std::make_shared<ChannelQueue>(driver_, 0, metrics_.counter("superseded", "", {}),
                                       [this, instance](brokers::Message&& message, config::Clock::Instant) {
                                         const std::lock_guard lock(mutex_);
                                         if (!takes_) return ChannelQueue::Handled::not_taken;
                                         taken_.push_back(instance + ":" + std::string(message.payload.text()));
                                         return ChannelQueue::Handled::done;
                                       });
    channels_->join(channel_, broker_, instance, queues_.at(instance));
  }
  auto close(const discovery::InstanceId& instance) {
    std::promise<decltype(queues_.at(instance)->close())> closed;
    driver_->post([&] { closed.set_value(queues_.at(instance)->close()); });
    return closed.get_future().get();
  }
  /// The instance is closed.
  void leave(const discovery::InstanceId& instance) { channels_->leave(channel_, instance, close(instance)); }

  /// A message comes from the broker. \return its tag
  std::uint64_t arrive(brokers::Message message, const std::string& instance) {
    message.driver_id = instance;
    broker_->handler(brokers::Delivery(std::move(message), false, settlements_, ++last_tag_));
    return last_tag_;
  }
  std::uint64_t arrive(const std::string& text, const std::string& instance) {
    brokers::Message message;
    message.payload = brokers::Payload::copy(text);
    return arrive(std::move(message), instance);
  }
  /// Looks at what waits, as the timer does: the first message of a line makes the host look, and one for no instance
  /// is dropped.
  void look() { arrive("", ""); }

  /// "instance:length" of what was passed.
  std::vector<std::string> passed() const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> passed;
    for (const auto& one : passed_) {
      passed.push_back(one.message.driver_id + ":" + std::to_string(one.message.payload.size()));
    }
    return passed;
  }
  /// Answers the message that was passed as the `index`th.
  void answer(std::size_t index, PassAnswer answer) {
    std::unique_lock lock(mutex_);
    const auto number = passed_.at(index).number;
    lock.unlock();
    channels_->answered(number, answer);
  }
  void take() {
    const std::lock_guard lock(mutex_);
    takes_ = true;
  }
  void pass_nothing(NotPassed why) {
    const std::lock_guard lock(mutex_);
    not_passed_ = why;
  }
  /// How many messages were dropped, by reason.
  std::map<std::string, double> lost() const {
    std::map<std::string, double> lost;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == "iotcloud_driver_lost_total") lost[sample.labels.at("reason")] += sample.value;
    }
    return lost;
  }
  bool took(const std::vector<std::string>& wanted) {
    return tests::eventually([&] {
      const std::lock_guard lock(mutex_);
      return taken_ == wanted;
    });
  }

  mutable std::mutex mutex_;
  std::vector<PassedMessage> passed_;    ///< guarded by mutex_, as are the next members
  std::optional<NotPassed> not_passed_;  ///< why nothing is passed
  bool takes_ = false;
  std::vector<std::string> taken_;

  PlannedChannel channel_;
  tests::HandClock clock_;
  config::Metrics metrics_;
  std::promise<void> go_on_;
  bool timers_run_ = false;
  std::shared_ptr<EventLoop> timers_ = std::make_shared<EventLoop>("timers");
  std::shared_ptr<EventLoop> driver_ = std::make_shared<EventLoop>("driver");
  std::shared_ptr<Settlements> settlements_ = std::make_shared<Settlements>();
  std::uint64_t last_tag_ = 0;
  std::shared_ptr<PlayedBroker> broker_ = std::make_shared<PlayedBroker>();
  std::map<discovery::InstanceId, std::shared_ptr<ChannelQueue>> queues_;
  std::optional<SharedChannels> channels_;
};

TEST_F(SharedChannelsTest, DoNotPassAMessageThatIsTooLargeWithItsPropertiesAndPassTheNextOne) {
  open(true);
  brokers::Message message;
  message.properties.set("huge", std::string(std::size_t{4} << 20, '\0'));
  const auto huge = arrive(message, "b");
  const auto payload = arrive(std::string((std::size_t{4} << 20) + 1, '\0'), "c");
  arrive("x", "b");
  EXPECT_THAT(passed(), IsEmpty());
  clock_.advance(SharedChannels::grace);
  look();
  EXPECT_EQ(settlements_->of(huge), Settlement::accept);
  EXPECT_EQ(settlements_->of(payload), Settlement::accept);
  EXPECT_THAT(lost(), ElementsAre(Pair("no_instance", 1), Pair("too_large", 2))) << "look() has the first";
  look();
  EXPECT_THAT(passed(), ElementsAre("b:1"));
}

TEST_F(SharedChannelsTest, PassALargeMessageInItsTurnBesideLinesWithTraffic) {
  open(true);
  const std::string usual(50'000, 'x');
  arrive(usual, "b");
  arrive(usual, "c");
  arrive(std::string(200'000, 'x'), "d");
  arrive(usual, "b");
  arrive(usual, "c");
  EXPECT_THAT(passed(), ElementsAre("b:50000", "c:50000"));
  answer(0, PassAnswer::handled);
  answer(1, PassAnswer::handled);
  EXPECT_THAT(passed(), ElementsAre("b:50000", "c:50000", "d:200000"));
  answer(2, PassAnswer::handled);
  EXPECT_THAT(passed(), ElementsAre("b:50000", "c:50000", "d:200000", "b:50000", "c:50000"));
}

TEST_F(SharedChannelsTest, DoNotGiveUpSoonWhatTheGatewayWasNotAskedAbout) {
  open(true);
  arrive(std::string(200'000, 'x'), "b");
  const auto small = arrive("x", "c");
  clock_.advance(SharedChannels::grace);
  look();
  EXPECT_EQ(settlements_->of(small), std::nullopt);
  answer(0, PassAnswer::handled);
  EXPECT_THAT(passed(), ElementsAre("b:200000", "c:1"));
  answer(1, PassAnswer::nowhere);
  EXPECT_EQ(settlements_->of(small), Settlement::accept);
  EXPECT_EQ(lost()["no_instance"], 2) << "one is of look()";
}

TEST_F(SharedChannelsTest, GiveUpAMessageForNobodyAlthoughItIsPassedAtEachLook) {
  open(true);
  const auto early = arrive("x", "b");
  const auto late = arrive("y", "b");
  answer(0, PassAnswer::nowhere);
  clock_.advance(SharedChannels::grace - 1ms);
  look();
  ASSERT_THAT(passed(), ElementsAre("b:1", "b:1"));
  answer(1, PassAnswer::nowhere);
  EXPECT_EQ(settlements_->of(early), std::nullopt);
  clock_.advance(1ms);
  look();
  EXPECT_EQ(settlements_->of(early), std::nullopt) << "it may be in a driver's hand";
  answer(2, PassAnswer::nowhere);
  EXPECT_EQ(settlements_->of(early), Settlement::accept);
  EXPECT_EQ(settlements_->of(late), Settlement::accept);
}

TEST_F(SharedChannelsTest, CountWhatNoFrameTakesAsTooLarge) {
  open(true);
  pass_nothing(NotPassed::too_large);
  const auto huge = arrive("x", "b");
  const auto next = arrive("y", "b");
  clock_.advance(SharedChannels::grace - 1ms);
  look();
  EXPECT_EQ(settlements_->of(huge), std::nullopt);
  clock_.advance(1ms);
  look();
  EXPECT_EQ(settlements_->of(huge), Settlement::accept);
  EXPECT_EQ(settlements_->of(next), std::nullopt) << "it was not asked about yet";
  look();
  EXPECT_EQ(settlements_->of(next), Settlement::accept);
  EXPECT_EQ(lost()["too_large"], 2);
}

TEST_F(SharedChannelsTest, CountWhatWaitedForAGatewayThatWasAway) {
  open(true);
  pass_nothing(NotPassed::gateway_away);
  const auto waits = arrive("x", "b");
  clock_.advance(SharedChannels::longest_wait - 1ms);
  look();
  EXPECT_EQ(settlements_->of(waits), std::nullopt);
  clock_.advance(1ms);
  look();
  EXPECT_EQ(settlements_->of(waits), Settlement::accept);
  EXPECT_EQ(lost()["gateway_away"], 1);
}

TEST_F(SharedChannelsTest, CountWhatWaitedForAnInstanceThatDidNotStart) {
  open(true);
  channels_->expect("here"_instance);
  const auto here = arrive("x", "here");
  const auto there = arrive("y", "there");
  answer(0, PassAnswer::nowhere);
  answer(1, PassAnswer::comes);
  clock_.advance(SharedChannels::longest_wait - 1ms);
  look();
  answer(2, PassAnswer::nowhere);
  EXPECT_EQ(settlements_->of(here), std::nullopt);
  EXPECT_EQ(settlements_->of(there), std::nullopt);
  clock_.advance(1ms);
  look();
  answer(3, PassAnswer::nowhere);
  EXPECT_EQ(settlements_->of(here), Settlement::accept);
  EXPECT_EQ(settlements_->of(there), Settlement::accept);
  EXPECT_EQ(lost()["not_started"], 2);
}

TEST_F(SharedChannelsTest, GiveUpAMessageThatWasNeverAskedAboutAfterTheLongestWait) {
  open(true);
  arrive(std::string(200'000, 'x'), "b");
  const auto small = arrive("x", "c");
  clock_.advance(SharedChannels::longest_wait);
  look();
  EXPECT_EQ(settlements_->of(small), Settlement::accept);
  EXPECT_EQ(lost()["not_asked"], 1);
}

TEST_F(SharedChannelsTest, CountTheDeadlineFromWhenAMessageFirstCame) {
  channel_.spec.deadline = 1s;
  open(false);
  join("b"_instance);
  channels_->expect("b"_instance);
  const auto returned = arrive("x", "b");
  clock_.advance(600ms);
  leave("b"_instance);
  join("b"_instance);
  clock_.advance(399ms);
  leave("b"_instance);
  look();
  EXPECT_EQ(settlements_->of(returned), std::nullopt);
  clock_.advance(1ms);
  look();
  EXPECT_EQ(settlements_->of(returned), Settlement::accept);
  EXPECT_EQ(lost()["deadline"], 1);
}

TEST_F(SharedChannelsTest, LetWhatAnInstanceGaveBackWaitForItsMoveToAnotherHost) {
  open(false);
  join("b"_instance);
  const auto returned = arrive("x", "b");
  clock_.advance(SharedChannels::grace);
  leave("b"_instance);
  look();
  EXPECT_EQ(settlements_->of(returned), std::nullopt);
  clock_.advance(SharedChannels::grace);
  look();
  EXPECT_EQ(settlements_->of(returned), Settlement::accept);
}

TEST_F(SharedChannelsTest, KeepTheOrderOfWhatComesWhileAnInstanceEnds) {
  open(false);
  join("b"_instance);
  const auto zero = arrive("0", "b");
  auto unhandled = close("b"_instance);
  const auto one = arrive("1", "b");  // its queue is closed, and it has not left
  const auto two = arrive("2", "b");
  channels_->leave(channel_, "b"_instance, std::move(unhandled));
  arrive("3", "b");
  for (const auto tag : {zero, one, two}) EXPECT_EQ(settlements_->of(tag), std::nullopt) << tag;
  take();
  join("b"_instance);
  EXPECT_TRUE(took({"b:0", "b:1", "b:2", "b:3"}));
}

TEST_F(SharedChannelsTest, KeepTheOrderOfWhatIsHandedOverWhileAnInstanceEnds) {
  open(true);
  const auto zero = arrive("0", "b");
  const auto one = arrive("1", "b");
  join("b"_instance);
  auto unhandled = close("b"_instance);
  answer(0, PassAnswer::comes);  // hands the line over, to a closed queue
  channels_->leave(channel_, "b"_instance, std::move(unhandled));
  for (const auto tag : {zero, one}) EXPECT_EQ(settlements_->of(tag), std::nullopt) << tag;
  take();
  join("b"_instance);
  EXPECT_TRUE(took({"b:0", "b:1"}));
}

TEST_F(SharedChannelsTest, JudgeEachMessageByItsOwnTime) {
  open(false);
  const auto first = arrive("x", "b");
  clock_.advance(SharedChannels::grace - 1ms);
  const auto second = arrive("x", "b");
  clock_.advance(1ms);
  look();
  EXPECT_EQ(settlements_->of(first), Settlement::accept);
  EXPECT_EQ(settlements_->of(second), std::nullopt);
  clock_.advance(SharedChannels::grace - 1ms);
  look();
  EXPECT_EQ(settlements_->of(second), Settlement::accept);
}

TEST_F(SharedChannelsTest, PassAMessageAgainAtALaterLookWhileItsInstanceIsAboutToBeOpen) {
  open(true);
  pass_nothing(NotPassed::gateway_away);
  arrive("x", "b");
  look();
  EXPECT_THAT(passed(), ElementsAre("b:1")) << "not at each look";
  channels_->nobody_answers();
  look();
  EXPECT_THAT(passed(), ElementsAre("b:1", "b:1")) << "a gateway that comes back is asked at once";
  let_timers_run();
  EXPECT_TRUE(tests::eventually([&] { return passed().size() >= 3; }));
}

}  // namespace
}  // namespace iotcloud::gateway
