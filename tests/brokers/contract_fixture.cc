#include "iotcloud/tests/brokers/contract_fixture.h"

#include <algorithm>
#include <atomic>
#include <set>
#include <thread>
#include <utility>

#include <iotcloud/brokers/embedded/server.h>

namespace iotcloud::brokers {
namespace {

class EmbeddedTestServer final : public TestServer {
 public:
  std::string url() const override { return "embedded://contract"; }
  void kill() override { server_.stop(); }
  void start() override { server_.start(); }

 private:
  embedded::Server server_ = embedded::Server::named("contract");
};

class PrivateTestServer : public TestServer {
 public:
  explicit PrivateTestServer(const std::string& script) : server_(script) {}
  std::string url() const override { return server_.url(); }
  void kill() override { server_.kill(); }
  void start() override { server_.start(); }
  tests::PrivateServer* process() override { return &server_; }

 private:
  tests::PrivateServer server_;
};

class KafkaTestServer final : public PrivateTestServer {
 public:
  KafkaTestServer() : PrivateTestServer("kafka.py") {}
  bool keeps_unread() const override { return true; }
  std::map<std::string, std::string> sharing_properties() const override { return {{"partitions", "2"}}; }
};

std::unique_ptr<TestServer> make_server(const std::string& kind) {
  if (kind == "embedded") return std::make_unique<EmbeddedTestServer>();
  if (kind == "rabbitmq") return std::make_unique<PrivateTestServer>("rabbitmq.py");
  if (kind == "kafka") return std::make_unique<KafkaTestServer>();
  if (kind == "activemq") return std::make_unique<PrivateTestServer>("activemq.py");
  throw std::runtime_error("no test server of kind " + kind);
}

std::map<std::string, std::unique_ptr<TestServer>>& servers() {
  static std::map<std::string, std::unique_ptr<TestServer>> all;
  return all;
}

}  // namespace

Handler Inbox::handler() {
  return [this](Delivery delivery) {
    Received received{std::string(delivery.message.payload.text()), delivery.message, delivery.redelivered};
    delivery.settle(verdict_ ? verdict_(received) : Settlement::accept);
    const std::lock_guard lock(mutex_);
    received_.push_back(std::move(received));
    more_.notify_all();
  };
}

bool Inbox::wait_until(const std::function<bool(const std::vector<Received>&)>& enough,
                       std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  return more_.wait_for(lock, limit, [&] { return enough(received_); });
}

bool Inbox::wait_for(std::size_t count, std::chrono::milliseconds limit) {
  return wait_until([&](const auto& received) { return received.size() >= count; }, limit);
}

bool Inbox::wait_for_last(const std::string& body, std::chrono::milliseconds limit) {
  return wait_until([&](const auto& received) { return !received.empty() && received.back().body == body; }, limit);
}

std::vector<Inbox::Received> Inbox::all() const {
  const std::lock_guard lock(mutex_);
  return received_;
}

std::vector<std::string> Inbox::bodies() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> bodies;
  for (const auto& received : received_) bodies.push_back(received.body);
  return bodies;
}

std::size_t Inbox::size() const {
  const std::lock_guard lock(mutex_);
  return received_.size();
}

std::vector<std::string> firsts(const Inbox& inbox) {
  std::set<std::string> seen;
  std::vector<std::string> bodies;
  for (const auto& received : inbox.all()) {
    if (seen.insert(received.body).second) {
      bodies.push_back(received.body);
    } else {
      EXPECT_TRUE(received.redelivered) << "a second " << received.body << " that is not marked";
    }
  }
  return bodies;
}

Handler Holder::handler() {
  return [this](Delivery delivery) {
    const std::lock_guard lock(mutex_);
    held_.push_back(std::move(delivery));
    more_.notify_all();
  };
}

bool Holder::wait_for(std::size_t count, std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  return more_.wait_for(lock, limit, [&] { return held_.size() >= count; });
}

std::size_t Holder::size() const {
  const std::lock_guard lock(mutex_);
  return held_.size();
}

std::string Holder::body(std::size_t index) const {
  const std::lock_guard lock(mutex_);
  return std::string(held_.at(index).message.payload.text());
}

void Holder::settle(std::size_t index, Settlement settlement) {
  std::unique_lock lock(mutex_);
  Delivery delivery = std::move(held_.at(index));
  lock.unlock();
  delivery.settle(settlement);
}

void Holder::drop_all() {
  std::vector<Delivery> dropped;
  const std::lock_guard lock(mutex_);
  dropped.swap(held_);
}

std::function<void(std::uint64_t, Outcome, const std::string&)> Outcomes::callback() {
  return [this](std::uint64_t number, Outcome outcome, const std::string& reason) {
    const std::lock_guard lock(mutex_);
    outcomes_[number].emplace_back(outcome, reason);
    more_.notify_all();
  };
}

bool Outcomes::wait_for(std::size_t count, std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  return more_.wait_for(lock, limit, [&] { return outcomes_.size() >= count; });
}

Outcome Outcomes::of(std::uint64_t number) const {
  const std::lock_guard lock(mutex_);
  const auto found = outcomes_.find(number);
  if (found == outcomes_.end() || found->second.size() != 1) {
    ADD_FAILURE() << "message " << number << " has " << (found == outcomes_.end() ? 0 : found->second.size())
                  << " outcomes";
    return Outcome::unknown;
  }
  return found->second.front().first;
}

std::string Outcomes::reason(std::uint64_t number) const {
  const std::lock_guard lock(mutex_);
  const auto found = outcomes_.find(number);
  return found == outcomes_.end() ? "" : found->second.front().second;
}

std::size_t Outcomes::size() const {
  const std::lock_guard lock(mutex_);
  return outcomes_.size();
}

std::size_t Outcomes::count(Outcome outcome) const {
  const std::lock_guard lock(mutex_);
  return static_cast<std::size_t>(std::count_if(
      outcomes_.begin(), outcomes_.end(), [&](const auto& entry) { return entry.second.front().first == outcome; }));
}

bool Outcomes::each_once() const {
  const std::lock_guard lock(mutex_);
  return std::all_of(outcomes_.begin(), outcomes_.end(), [](const auto& entry) { return entry.second.size() == 1; });
}

std::vector<std::string> numbered(int from, int to) {
  std::vector<std::string> bodies;
  for (int i = from; i <= to; ++i) bodies.push_back(std::to_string(i));
  return bodies;
}

Message text_message(const std::string& body) {
  Message message;
  message.payload = Payload::copy(body);
  message.driver_id = "driver";
  return message;
}

void publish_numbers(Publisher& publisher, int from, int to) {
  for (const auto& body : numbered(from, to)) {
    ASSERT_EQ(publisher.publish(text_message(body)), PublishStatus::accepted) << body;
  }
}

void expect_arrivals(Publisher& publisher, Inbox& inbox, int from) {
  constexpr int count = 3;
  publish_numbers(publisher, from, from + count - 1);
  EXPECT_TRUE(inbox.wait_for(count));
  EXPECT_EQ(inbox.bodies(), numbered(from, from + count - 1));
}

void BrokerContract::SetUp() {
  auto& known = servers()[GetParam()];
  if (!known) known = make_server(GetParam());
}

void BrokerContract::TearDownTestSuite() {
  servers().clear();
}

TestServer& BrokerContract::server() const {
  return *servers().at(GetParam());
}

std::unique_ptr<Broker> BrokerContract::broker(std::map<std::string, std::string> properties) const {
  BrokerOptions options;
  options.properties = std::move(properties);
  options.urls = {server().url()};
  options.heartbeat = contract_heartbeat;
  return make_broker(options);
}

std::unique_ptr<Outage> BrokerContract::hold_up(const Broker& broker) const {
  if (!server().keeps_unread()) return nullptr;
  auto outage = std::make_unique<Outage>(server());
  EXPECT_TRUE(eventually([&] { return broker.state() == ConnectionState::connecting; }));
  return outage;
}

Topic BrokerContract::topic(bool durable) const {
  static std::atomic<int> last{0};
  const std::string test = testing::UnitTest::GetInstance()->current_test_info()->name();
  Topic topic;
  topic.exchange = durable ? "contract_durable" : "contract";
  topic.name = "gw.driver." + test.substr(0, test.find('/')) + "." + std::to_string(++last);
  topic.durable = durable;
  return topic;
}

void BrokerContract::await_active(const Subscription& subscription) {
  ASSERT_TRUE(eventually([&] { return subscription.active(); })) << "the subscription never became active";
}

}  // namespace iotcloud::brokers
