// What becomes of tuples for driver instances that have no channel now: a RouteTable with an embedded registry and
// broker, on a clock that the test moves.
#include <algorithm>
#include <atomic>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/endpoints/sending/route_table.h>

namespace iotcloud::topology {
namespace {

using discovery::DriverState;
using tests::eventually;
using namespace std::chrono_literals;

/// Writes down what becomes of tuples, by their source_task(). Thread safe.
class Verdict final : public OutputCollector {
 public:
  enum class Answer { none, acked, failed, retried };
  void ack(const Tuple& tuple) override {
    set(tuple, Answer::acked);
    if (const auto call = std::exchange(on_next_ack, nullptr)) call();
  }
  void fail(const Tuple& tuple) override { set(tuple, Answer::failed); }
  void retry(const Tuple& tuple) override { set(tuple, Answer::retried); }
  void reset_timeout(const Tuple& tuple) override {
    const std::lock_guard lock(mutex_);
    ++resets_[tuple.source_task()];
  }
  void report_error(const std::string&) override {}

  std::function<void()> on_next_ack;  ///< called once, where that ack is; set it while nobody acks

  Answer of(int number) const {
    const std::lock_guard lock(mutex_);
    const auto found = answers_.find(number);
    return found == answers_.end() ? Answer::none : found->second;
  }
  int resets(int number) const {
    const std::lock_guard lock(mutex_);
    const auto found = resets_.find(number);
    return found == resets_.end() ? 0 : found->second;
  }

 private:
  void do_emit(std::string_view, std::span<const Tuple>, Values&&, int) override {}
  void set(const Tuple& tuple, Answer answer) {
    const std::lock_guard lock(mutex_);
    answers_[tuple.source_task()] = answer;
  }
  mutable std::mutex mutex_;
  std::map<int, Answer> answers_;  ///< guarded by mutex_
  std::map<int, int> resets_;      ///< guarded by mutex_
};
using Answer = Verdict::Answer;

class Routes : public ::testing::Test {
 protected:
  Routes() {
    static int number = 0;
    url_ = "embedded://route-table-test-" + std::to_string(++number);
    discovery::RegistryOptions options;
    options.url = url_;
    registry_ = discovery::make_registry(options);
    brokers::BrokerOptions broker;
    broker.urls = {url_};
    broker_ = brokers::make_broker(broker);
    subscription_ = broker_->subscribe({"", "g.d.down", false}, {}, [this](brokers::Delivery delivery) {
      const std::lock_guard lock(mutex_);
      received_.emplace_back(delivery.message.payload.text());
      delivery.settle(brokers::Settlement::accept);
    });
    endpoint_.broker = "local";
    endpoint_.driver = "d"_driver;
    endpoint_.channel = "control";
    endpoint_.sending.ack_when = AckWhen::accepted;  // a tuple that is sent is acked before send() returns
  }
  ~Routes() override {
    if (table_) table_->leave(answers_);
  }

  void start() {
    auto services = std::make_shared<EndpointServices>();
    services->topology = "t"_topology;
    services->registry = registry_.get();
    services->brokers = std::make_shared<brokers::BrokerPool>(nullptr, &metrics_);
    services->clock = &clock_;
    services->metrics = &metrics_;
    table_ = std::make_unique<RouteTable>(services, "out", endpoint_);
    table_->join();
  }
  /// Shows an instance in the registry in that state, as its gateway does.
  void show(const std::string& id, DriverState state) {
    show_channel(id);
    show_record(id, state);
  }
  void show_channel(const std::string& id) {
    const discovery::InstanceId instance(id);
    discovery::ChannelRecord channel;
    channel.name = "control";
    channel.transport = "local";
    channel.direction = discovery::Direction::in;
    channel.properties = {{"routingKey", "down"}};
    channel.broker_url = url_;
    channel.gateway = "g"_gateway;
    channel.driver = "d"_driver;
    channel.instance = instance;
    channel.shared = true;
    discovery::put(*registry_, paths_.channel("d"_driver, instance, "control"), discovery::encode(channel));
  }
  void show_record(const std::string& id, DriverState state, bool starts_again = false) {
    const discovery::InstanceId instance(id);
    discovery::DriverRecord record;
    record.name = "d"_driver;
    record.instance = instance;
    record.gateway = "g"_gateway;
    record.state = state;
    record.starts_again = starts_again;
    discovery::put(*registry_, paths_.instance("d"_driver, instance), discovery::encode(record));
  }
  /// Waits until the table has heard of that state of an instance that it knows: the registry tells a node's watchers
  /// in the order in which they came.
  bool hears(const std::string& id, DriverState state, bool starts_again = false) {
    const auto path = paths_.instance("d"_driver, discovery::InstanceId(id));
    std::atomic<bool> told{false};
    const auto watch = registry_->watch_node(path, [&](const std::optional<discovery::Node>& node) {
      if (!node) return;
      const auto record = discovery::decode_driver(node->data, path);
      if (record.state == state && record.starts_again == starts_again) told = true;
    });
    return eventually([&] { return told.load(); });
  }
  /// Waits until the table has heard that its driver has no instances.
  bool hears_of_no_instance() {
    std::atomic<bool> told{false};
    const auto watch =
        registry_->watch_children(paths_.driver("d"_driver), [&](const std::optional<std::vector<std::string>>& names) {
          if (!names || names->empty()) told = true;
        });
    return eventually([&] { return told.load(); });
  }
  int send(const std::string& id) {
    const int number = ++last_;
    auto& data = data_.emplace_back();
    data.handles = 1;  // the test's own: the deque keeps it
    data.source_task = number;
    brokers::Message message;
    message.payload = brokers::Payload::copy(std::to_string(number));
    message.driver_id = id;
    table_->send(std::move(message), Tuple(&data), answers_);
    return number;
  }
  /// Whether a new tuple for the instance outlasts the time for instances that nobody knows.
  bool one_waits(const std::string& id) {
    const int number = send(id);
    clock_.advance(RouteTable::grace);
    table_->on_tick();
    return answers_.of(number) == Answer::none;
  }
  /// Makes the instance an inactive one that nothing came for in a long time, and waits until the table knows it.
  bool becomes_inactive(const std::string& id) {
    show_record(id, DriverState::inactive);
    const double before = lost("inactive");
    const bool known = eventually([&] {
      send(id);
      clock_.advance(RouteTable::grace);
      table_->on_tick();
      return lost("inactive") > before;
    });
    clock_.advance(10 * RouteTable::grace);
    table_->on_tick();
    return known;
  }
  bool received(int number) {
    const std::lock_guard lock(mutex_);
    return std::find(received_.begin(), received_.end(), std::to_string(number)) != received_.end();
  }
  double metric(const std::string& name) const {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == name) sum += sample.value;
    }
    return sum;
  }

  double lost(const std::string& reason) const {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == "iotcloud_bolt_lost_total" && sample.labels.at("reason") == reason) sum += sample.value;
    }
    return sum;
  }

  struct Data final : detail::TupleData {
    void recycle() noexcept override {}
  };
  std::string url_;
  tests::HandClock clock_;
  config::Metrics metrics_;
  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<brokers::Broker> broker_;
  std::mutex mutex_;
  std::vector<std::string> received_;  ///< guarded by mutex_
  std::unique_ptr<brokers::Subscription> subscription_;
  EndpointDefinition endpoint_;
  std::deque<Data> data_;
  int last_ = 0;
  Verdict answers_;
  /// A tuple for the instance "a", which comes, is dropped for the deadline of 10 s, and not before.
  void expect_a_drop_at_the_deadline() {
    start();
    ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
    const int number = send("a");
    const double unknown = metric("iotcloud_bolt_unknown_driver_total");
    clock_.advance(10s - 1ms);
    table_->on_tick();
    EXPECT_EQ(answers_.of(number), Answer::none);
    clock_.advance(1ms);
    table_->on_tick();
    EXPECT_EQ(answers_.of(number), Answer::acked);
    EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
    EXPECT_EQ(lost("deadline"), 2);
    EXPECT_EQ(metric("iotcloud_bolt_lost_total"), 2);
  }

  std::unique_ptr<RouteTable> table_;
};

class AnInstanceThatIsAboutToBeActive : public Routes, public ::testing::WithParamInterface<DriverState> {};

TEST_P(AnInstanceThatIsAboutToBeActive, IsWaitedForByItsTuplesInOrder) {
  start();
  show("a", DriverState::active);
  ASSERT_TRUE(eventually([&] { return received(send("a")); }));
  show("a", GetParam());
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int before = last_;
  const int first = send("a");
  const int second = send("a");
  clock_.advance(RouteTable::return_limit - RouteTable::grace - 1ms);
  table_->on_tick();
  EXPECT_GE(answers_.resets(first), 1) << "its message time-out must not pass meanwhile";
  show("a", DriverState::active);
  ASSERT_TRUE(eventually([&] { return received(second); }));
  const std::lock_guard lock(mutex_);
  EXPECT_THAT(std::vector<std::string>(received_.end() - 3, received_.end()),
              ::testing::ElementsAre(std::to_string(before), std::to_string(first), std::to_string(second)));
}

INSTANTIATE_TEST_SUITE_P(States, AnInstanceThatIsAboutToBeActive,
                         ::testing::Values(DriverState::deployed, DriverState::starting, DriverState::stopping),
                         [](const auto& test) { return to_string(test.param); });

TEST_F(Routes, OfAnInstanceThatFailedAndIsStartedAgainKeepItsTuplesThroughEachFailure) {
  start();
  show("a", DriverState::active);
  ASSERT_TRUE(eventually([&] { return received(send("a")); }));
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  show_record("a", DriverState::failed, true);
  ASSERT_TRUE(hears("a", DriverState::failed, true));
  const int first = send("a");
  for (const auto pause : {4s, 8s, 16s, 30s}) {  // as a gateway's pauses grow
    clock_.advance(pause);
    table_->on_tick();
    EXPECT_EQ(answers_.of(first), Answer::none);
  }
  EXPECT_GE(answers_.resets(first), 1);
  const int second = send("a");
  show("a", DriverState::active);
  EXPECT_TRUE(eventually([&] { return received(second); }));
  EXPECT_TRUE(received(first));
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
}

TEST_F(Routes, OfAnInstanceThatComesBackKeepAllItsTuplesHoweverManyWait) {
  start();
  show("a", DriverState::starting);
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  int last = 0;
  for (std::size_t i = 0; i < RouteTable::most_waiting; ++i) last = send("a");
  EXPECT_EQ(answers_.of(last), Answer::none) << "acked, it would be lost";
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
  show("a", DriverState::active);
  EXPECT_TRUE(eventually([&] { return received(last); }));
}

TEST_F(Routes, OfAnInstanceThatFailedWaitForItUpToTheirDeadline) {
  endpoint_.sending.deadline = 10s;
  show_record("a", DriverState::failed, true);
  expect_a_drop_at_the_deadline();
}

TEST_F(Routes, OfAnInstanceThatIsLeftAloneAfterItFailedWaitAMomentOnly) {
  show_record("a", DriverState::failed, true);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int number = send("a");
  show_record("a", DriverState::failed);
  ASSERT_TRUE(hears("a", DriverState::failed));
  clock_.advance(RouteTable::grace - 1ms);
  table_->on_tick();
  EXPECT_EQ(answers_.of(number), Answer::none) << "a person may be about to start it";
  clock_.advance(1ms);
  table_->on_tick();
  EXPECT_EQ(answers_.of(number), Answer::acked);
  EXPECT_EQ(answers_.of(send("a")), Answer::acked) << "at once";
}

TEST_F(Routes, OfAnInstanceThatHasComeKeepTheTuplesThatAreStillToBeSent) {
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  send("a");
  const int last = send("a");
  clock_.advance(RouteTable::grace);
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  answers_.on_next_ack = [&] { table_->on_tick(); };  // after the first of them was sent
  show("a", DriverState::active);
  ASSERT_TRUE(eventually([&] { return answers_.of(last) == Answer::acked; }));
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
  EXPECT_TRUE(eventually([&] { return received(last); }));
}

TEST_F(Routes, OfAnActiveInstanceWhoseChannelIsNotToldYetKeepTheTuplesThatWaitedForIt) {
  show_record("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int first = send("a");
  clock_.advance(RouteTable::grace);
  show_record("a", DriverState::active);
  ASSERT_TRUE(hears("a", DriverState::active));
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  const int second = send("a");
  clock_.advance(RouteTable::grace - 1ms);
  table_->on_tick();
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
  show_channel("a");
  EXPECT_TRUE(eventually([&] { return answers_.of(second) == Answer::acked; }));
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
  EXPECT_TRUE(eventually([&] { return received(first) && received(second); }));
}

TEST_F(Routes, OfAnActiveInstanceWithoutTheChannelAreGivenUp) {
  show_record("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int early = send("a");
  show_record("a", DriverState::active);
  ASSERT_TRUE(hears("a", DriverState::active));
  clock_.advance(RouteTable::grace);
  const int late = send("a");
  table_->on_tick();
  EXPECT_EQ(answers_.of(early), Answer::acked);
  EXPECT_GE(lost("no_channel"), 1);
  EXPECT_EQ(answers_.of(late), Answer::none) << "as for an instance that was never seen";
  clock_.advance(RouteTable::grace);
  table_->on_tick();
  EXPECT_EQ(answers_.of(late), Answer::acked);
}

TEST_F(Routes, OfAnInstanceThatDoesNotComeAreGivenUpInTheEnd) {
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int number = send("a");
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  clock_.advance(RouteTable::return_limit);
  table_->on_tick();
  EXPECT_EQ(answers_.of(number), Answer::acked);
  EXPECT_EQ(lost("not_started"), 2);
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown) << "it is known";
}

TEST_F(Routes, OfAnInstanceThatDoesNotComeFailWhereTheFileSaysSo) {
  endpoint_.sending.unknown_driver = UnknownDriver::fail;
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  clock_.advance(RouteTable::return_limit);
  table_->on_tick();
  EXPECT_EQ(answers_.of(last_), Answer::failed);
  EXPECT_EQ(lost("not_started"), 1);
}

TEST_F(Routes, WithoutARecordAreUnknownOnlyBelowTheMostThatWait) {
  start();
  std::vector<int> waiting;
  for (std::size_t i = 0; i < RouteTable::most_waiting; ++i) waiting.push_back(send("nobody"));
  const int surplus = send("nobody");
  EXPECT_EQ(answers_.of(waiting.back()), Answer::none);
  EXPECT_EQ(answers_.of(surplus), Answer::acked);
  EXPECT_EQ(lost("too_many_wait"), 1);
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), 0);
  clock_.advance(RouteTable::grace);
  table_->on_tick();
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), RouteTable::most_waiting);
  EXPECT_EQ(lost("too_many_wait"), 1);
}

TEST_F(Routes, OfAnInstanceThatStartsDropATupleWhoseDeadlinePasses) {
  endpoint_.sending.deadline = 10s;
  show("a", DriverState::starting);
  expect_a_drop_at_the_deadline();
}

TEST_F(Routes, OfAnInstanceThatStartsLeaveItsTuplesToTheNextWorkerWhenThisOneStops) {
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int number = send("a");
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  table_->end_grace();
  EXPECT_EQ(answers_.of(number), Answer::retried);
  EXPECT_EQ(lost("closed"), 2);
  EXPECT_EQ(answers_.of(send("a")), Answer::retried) << "one that comes later, too";
  EXPECT_EQ(lost("closed"), 3);
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
}

TEST_F(Routes, OfAnInstanceThatWasStoppedWaitAMomentBecauseItMayBeARestart) {
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  show("a", DriverState::inactive);
  ASSERT_TRUE(hears("a", DriverState::inactive));
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  const int number = send("a");
  table_->on_tick();
  EXPECT_EQ(answers_.of(number), Answer::none);
  EXPECT_TRUE(eventually([&] {
    clock_.advance(RouteTable::grace / 2);
    table_->on_tick();
    return answers_.of(send("a")) ==
           Answer::acked;  // at once: it has been inactive for long, and tuples come all the time
  }));
  EXPECT_EQ(answers_.of(number), Answer::acked);
  EXPECT_GE(lost("inactive"), 3);
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
}

TEST_F(Routes, OfAnInstanceThatBeganAgainAreSentThoughTheRegistrySaysSoLaterThanItsFirstMessageComes) {
  start();
  for (int begins = 0; begins < 2; ++begins) {
    ASSERT_TRUE(becomes_inactive("a"));
    const int number = send("a");
    clock_.advance(RouteTable::grace - 1ms);
    table_->on_tick();
    EXPECT_EQ(answers_.of(number), Answer::none);
    show("a", DriverState::active);
    EXPECT_TRUE(eventually([&] { return received(number); }));
  }
}

TEST_F(Routes, OfAnInactiveInstanceHoldUpASpoutThatMayHaveFewUnderWayOnlyOnce) {
  start();
  ASSERT_TRUE(becomes_inactive("a"));
  const int first = send("a");
  clock_.advance(RouteTable::grace);
  table_->on_tick();
  EXPECT_EQ(answers_.of(first), Answer::acked);
  EXPECT_EQ(answers_.of(send("a")), Answer::acked) << "the spout sends it when the first one is settled";
}

TEST_F(Routes, OfAnInstanceWhoseRecordIsGoneWaitAMomentBecauseItMayComeBack) {
  show("a", DriverState::starting);
  start();
  ASSERT_TRUE(eventually([&] { return one_waits("a"); }));
  const int before = last_;
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "a"_instance));
  ASSERT_TRUE(hears_of_no_instance());
  const int after = send("a");
  clock_.advance(RouteTable::grace - 1ms);
  table_->on_tick();
  EXPECT_EQ(answers_.of(before), Answer::none);
  EXPECT_EQ(answers_.of(after), Answer::none);
  clock_.advance(1ms);
  table_->on_tick();
  EXPECT_EQ(answers_.of(before), Answer::acked);
  EXPECT_EQ(answers_.of(after), Answer::acked);
  EXPECT_EQ(answers_.of(send("a")), Answer::acked) << "at once: it has been gone for long";
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), last_);
}

TEST_F(Routes, OfAnInstanceWhoseRecordComesBackKeepTheirTuples) {
  show("a", DriverState::active);
  start();
  ASSERT_TRUE(eventually([&] { return received(send("a")); }));
  const double unknown = metric("iotcloud_bolt_unknown_driver_total");
  discovery::remove_tree(*registry_, paths_.instance("d"_driver, "a"_instance));
  ASSERT_TRUE(hears_of_no_instance());
  const int number = send("a");
  table_->on_tick();
  show("a", DriverState::active);
  EXPECT_TRUE(eventually([&] { return received(number); }));
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), unknown);
}

}  // namespace
}  // namespace iotcloud::topology
