// When a bolt that sends answers for its tuples: with a publisher that does what the test says.
#include <deque>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/topology/endpoints/sending/channel_sender.h>

namespace iotcloud::topology {
namespace {

using brokers::Outcome;
using brokers::PublishStatus;
using testing::ElementsAre;
using testing::IsEmpty;

/// A publisher that takes what it is told to take; the test says what became of it.
struct Script {
  brokers::PublisherOptions options;
  std::vector<std::string> published;
  bool full = false;
  bool confirm_before_publish_returns = false;
  std::function<void()> during_publish, when_full;
  int alive = 0;
  std::set<std::uint64_t> open;  ///< publish numbers without an outcome

  void outcome(std::uint64_t number, Outcome outcome, const std::string& reason = "") {
    open.erase(number);
    options.on_outcome(number, outcome, reason);
  }
};

class ScriptedPublisher final : public brokers::Publisher {
 public:
  explicit ScriptedPublisher(Script& script) : script_(script) { ++script_.alive; }
  ~ScriptedPublisher() override {
    --script_.alive;
    while (!script_.open.empty()) script_.outcome(*script_.open.begin(), Outcome::unknown);
  }
  brokers::Published publish(brokers::Message message) override {
    if (script_.full) {
      if (script_.when_full) script_.when_full();
      return {PublishStatus::would_block};
    }
    script_.published.emplace_back(message.payload.text());
    const std::uint64_t number = script_.published.size();
    script_.open.insert(number);
    if (script_.during_publish) script_.during_publish();
    if (script_.confirm_before_publish_returns) {
      std::thread([&] { script_.outcome(number, Outcome::confirmed); }).join();
    }
    return {PublishStatus::accepted, number};
  }
  bool drain(std::chrono::milliseconds) override { return true; }
  std::size_t pending() const override { return script_.open.size(); }

 private:
  Script& script_;
};

class ScriptedBroker final : public brokers::Broker {
 public:
  explicit ScriptedBroker(Script& script) : script_(script) {}
  std::unique_ptr<brokers::Publisher> publisher(const brokers::Topic&,
                                                const brokers::PublisherOptions& options) override {
    script_.options = options;
    return std::make_unique<ScriptedPublisher>(script_);
  }
  std::unique_ptr<brokers::Subscription> subscribe(const brokers::Topic&, const brokers::SubscriptionOptions&,
                                                   brokers::Handler) override {
    return nullptr;
  }
  brokers::ConnectionState state() const override { return brokers::ConnectionState::connected; }
  const std::string& url() const override { return url_; }

 private:
  Script& script_;
  const std::string url_ = "scripted://";
};

/// Writes down what becomes of tuples, by their source_task().
class Answers final : public OutputCollector {
 public:
  void ack(const Tuple& tuple) override { acked.push_back(tuple.source_task()); }
  void fail(const Tuple& tuple) override { failed.push_back(tuple.source_task()); }
  void retry(const Tuple& tuple) override { retried.push_back(tuple.source_task()); }
  void reset_timeout(const Tuple& tuple) override { reset.push_back(tuple.source_task()); }
  void report_error(const std::string&) override {}

  std::vector<int> acked, failed, retried, reset;

 private:
  void do_emit(std::string_view, std::span<const Tuple>, Values&&, int) override {}
};

class SentTuples : public testing::Test {
 protected:
  struct Data final : detail::TupleData {
    void recycle() noexcept override {}
  };

  void open(AckWhen ack_when = AckWhen::confirmed) {
    sender_ =
        ChannelSender::open(std::make_shared<ScriptedBroker>(script_), {"", "t", false}, {}, ack_when, meters_, fence_);
  }
  void TearDown() override {
    if (sender_) sender_->close();
    EXPECT_EQ(script_.alive, 0);
  }
  Tuple tuple(int number, bool tracked = true) {
    auto& data = data_.emplace_back();
    data.handles = 1;  // the test's own: the deque keeps it
    data.source_task = number;
    data.born_ns = born_ns;
    if (tracked) data.tree = reinterpret_cast<internal::Tree*>(&data);  // only compared with null
    return Tuple(&data);
  }
  void send(int number, bool tracked = true) {
    brokers::Message message;
    message.payload = brokers::Payload::copy(std::to_string(number));
    sender_->send(std::move(message), tuple(number, tracked), answers_);
  }
  std::size_t kept() const {
    std::size_t count = 0;
    for (const auto& data : data_) count += data.handles > 1;
    return count;
  }
  double lost(const std::string& reason) const {
    for (const auto& sample : metrics_.collect()) {
      const auto label = sample.labels.find("reason");
      if (sample.name == "iotcloud_bolt_lost_total" && label != sample.labels.end() && label->second == reason) {
        return sample.value;
      }
    }
    return 0;
  }

  static constexpr std::int64_t born_ns = 1;  // before any fence
  config::Metrics metrics_;
  const std::shared_ptr<StandstillFence> fence_ = std::make_shared<StandstillFence>();
  std::shared_ptr<SenderMeters> meters_ = std::make_shared<SenderMeters>(metrics_, config::Labels{});
  Script script_;
  std::deque<Data> data_;
  Answers answers_;
  std::shared_ptr<ChannelSender> sender_;
};

TEST_F(SentTuples, AreAckedWhenTheBrokerHasConfirmedTheirMessagesAndNotBefore) {
  open();
  for (const int number : {1, 2, 3}) send(number);
  EXPECT_THAT(script_.published, ElementsAre("1", "2", "3"));
  EXPECT_THAT(answers_.acked, IsEmpty());
  script_.outcome(2, Outcome::confirmed);
  EXPECT_THAT(answers_.acked, ElementsAre(2));
  script_.outcome(1, Outcome::confirmed);
  script_.outcome(3, Outcome::confirmed);
  EXPECT_THAT(answers_.acked, ElementsAre(2, 1, 3));
  EXPECT_EQ(kept(), 0U);
}

TEST_F(SentTuples, FailWhenTheBrokerRefusesThem) {
  open();
  send(1);
  send(2);
  script_.outcome(1, Outcome::refused, "too large");
  script_.outcome(2, Outcome::confirmed);
  EXPECT_THAT(answers_.failed, ElementsAre(1));
  EXPECT_THAT(answers_.retried, IsEmpty());
  EXPECT_THAT(answers_.acked, ElementsAre(2));
  EXPECT_EQ(lost("refused"), 1);
}

TEST_F(SentTuples, AreTriedAgainWithoutBlameWhenTheChannelGoesBeforeTheBrokerHasAnswered) {
  open();
  send(1);
  script_.full = true;
  send(2);  // held back
  sender_->close();
  EXPECT_THAT(answers_.retried, testing::UnorderedElementsAre(1, 2));
  EXPECT_EQ(lost("unknown"), 1);
  EXPECT_EQ(lost("closed"), 1);
  send(3);
  EXPECT_THAT(answers_.retried, testing::Contains(3));
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_THAT(answers_.acked, IsEmpty());
}

TEST_F(SentTuples, AreTriedAgainWithoutBlameWhenTheFenceVoidsThem) {
  open();
  send(1);
  script_.outcome(1, Outcome::dropped, "fenced");
  EXPECT_THAT(answers_.retried, ElementsAre(1));
  script_.full = true;
  send(2);
  fence_->raise();
  script_.full = false;
  script_.options.on_writable();
  EXPECT_THAT(answers_.retried, ElementsAre(1, 2));
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_EQ(lost("fenced"), 2);
}

TEST_F(SentTuples, AreTriedAgainWithoutBlameWhenTheChannelGoesWhileTheyAreBeingSent) {
  open();
  script_.during_publish = [&] { std::thread([&] { sender_->close(); }).join(); };
  send(1);
  EXPECT_THAT(answers_.retried, ElementsAre(1));
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_EQ(script_.alive, 0);
}

TEST_F(SentTuples, AreTriedAgainWithoutBlameWhenTheChannelGoesWhileItsPublisherSaysThatItIsFull) {
  open();
  script_.full = true;
  script_.when_full = [&] { std::thread([&] { sender_->close(); }).join(); };
  send(1);
  EXPECT_THAT(answers_.retried, ElementsAre(1));
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_EQ(lost("closed"), 1);
  EXPECT_EQ(kept(), 0U);
}

TEST_F(SentTuples, AreAckedWhenTheChannelsOwnPolicyDropsTheirMessages) {
  open();
  send(1);
  script_.outcome(1, Outcome::dropped, "deadline");
  EXPECT_THAT(answers_.acked, ElementsAre(1));
  EXPECT_EQ(lost("deadline"), 1);
}

TEST_F(SentTuples, AreAckedAtOnceWhenAcceptanceIsEnoughOrNobodyHearsOfIt) {
  open(AckWhen::accepted);
  send(1);
  EXPECT_THAT(answers_.acked, ElementsAre(1));
  script_.outcome(1, Outcome::refused);  // counted, and no second answer
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_EQ(lost("refused"), 1);
  sender_->close();

  script_.published.clear();
  open();
  send(2, false);
  send(3);
  EXPECT_THAT(answers_.acked, ElementsAre(1, 2));
  script_.outcome(1, Outcome::confirmed);
  script_.outcome(2, Outcome::confirmed);
  EXPECT_THAT(answers_.acked, ElementsAre(1, 2, 3));
}

TEST_F(SentTuples, AreAckedAlsoWhenTheConfirmationComesBeforePublishReturns) {
  open();
  script_.confirm_before_publish_returns = true;
  send(1);
  send(2);
  EXPECT_THAT(answers_.acked, ElementsAre(1, 2));
  EXPECT_EQ(kept(), 0U);
}

TEST_F(SentTuples, GoInTheirOrderAndUnderTheirOwnNumbersAfterThePublisherWasFull) {
  open();
  send(1);
  script_.full = true;
  send(2);
  send(3);
  script_.full = false;
  script_.options.on_writable();
  EXPECT_THAT(script_.published, ElementsAre("1", "2", "3"));
  EXPECT_THAT(answers_.acked, IsEmpty());
  script_.outcome(3, Outcome::refused);
  script_.outcome(2, Outcome::confirmed);
  EXPECT_THAT(answers_.failed, ElementsAre(3));
  EXPECT_THAT(answers_.acked, ElementsAre(2));
}

TEST_F(SentTuples, DoNotTimeOutWhileTheyWaitForTheBroker) {
  open();
  send(1);
  send(2);
  script_.full = true;
  send(3);
  script_.outcome(1, Outcome::confirmed);
  sender_->reset_timeouts();
  EXPECT_THAT(answers_.reset, testing::UnorderedElementsAre(2, 3));
}

TEST_F(SentTuples, AreForgottenWithTheirTask) {
  open();
  send(1);
  script_.full = true;
  send(2);
  sender_->forget(answers_);
  EXPECT_EQ(kept(), 0U);
  script_.outcome(1, Outcome::confirmed);
  sender_->close();
  EXPECT_THAT(answers_.acked, IsEmpty());
  EXPECT_THAT(answers_.failed, IsEmpty());
  EXPECT_THAT(answers_.retried, IsEmpty());
}

}  // namespace
}  // namespace iotcloud::topology
