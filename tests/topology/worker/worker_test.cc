// What a worker says of itself: why it gets no more messages, and what it has left undone; and what its tuples record.
#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

/// Keeps the tuples of its window.
class KeepingWindow final : public WindowedBolt {
 public:
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector&) override {}
  void execute(const TupleWindow&) override {}
};

/// Keeps all tuples unacked until release().
class KeepingBolt final : public Bolt {
 public:
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override {
    const std::lock_guard lock(mutex);
    collector_ = &collector;
    released = false;
  }
  void execute(const Tuple& tuple) override {
    const std::lock_guard lock(mutex);
    if (released) return collector_->ack(tuple);
    kept.push_back(tuple);
  }
  /// Tuples do not outlive the runtime, and need not be acked then.
  void cleanup() override {
    const std::lock_guard lock(mutex);
    kept.clear();
  }
  /// Acks what is kept, and all that comes.
  static void release() {
    const std::lock_guard lock(mutex);
    released = true;
    for (const Tuple& tuple : kept) collector_->ack(tuple);
    kept.clear();
  }

 private:
  static inline std::mutex mutex;
  static inline OutputCollector* collector_ = nullptr;
  static inline bool released = false;
  static inline std::vector<Tuple> kept;
};

/// Notes when the tuple was born that it executed last, and hands it on.
class BornBolt final : public BasicBolt {
 public:
  static constexpr std::int64_t none_came = -1;
  static inline std::atomic<std::int64_t> born{none_came};
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    collector.emit(Values(tuple.at(0), tuple.at(1), tuple.at(2)));
    born = tuple.data()->born_ns;
  }
};

class WorkerSays : public Endpoints {
 protected:
  /// Runs a topology whose bolt keeps the tuples of an instance's channel, and waits until that is read.
  Worker& run_keeping(int prefetch) {
    ComponentRegistry components;
    components.add_bolt<KeepingBolt>("Keep");
    Worker& worker = run_yaml(
        "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time], "
        "properties: {prefetchCount: " +
            std::to_string(prefetch) + "}}\nbolts:\n  keep: {class: Keep, inputs: {from: in}}\n",
        std::move(components));
    show_driver("one");
    EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
    return worker;
  }
  /// What hinders the only worker, as its record has it.
  std::string trouble() {
    const auto workers = discovery::list_workers(*registry_, paths_, discovery::TopologyName("t"));
    return workers.size() == 1 ? workers.front().trouble : "there is no single worker";
  }
};

TEST_F(WorkerSays, InItsRecordThatThePrefetchIsTheLimitAndNoLongerWhenItIsNot) {
  run_keeping(5);
  EXPECT_EQ(trouble(), "");
  const auto publisher = device("one");
  for (int i = 0; i < 20; ++i) publisher->publish(message(std::to_string(i), "one"));
  EXPECT_TRUE(eventually([&] { return trouble().starts_with("in: prefetchCount (5) is the limit: "); })) << trouble();
  KeepingBolt::release();
  EXPECT_TRUE(eventually([&] { return trouble().empty(); })) << trouble();
}

TEST_F(WorkerSays, HowOldMessagesAreWhenTheyComeAndHowManyWaitAtTheBroker) {
  Worker& worker = run_keeping(10);
  const auto publisher = device("one");
  const auto old = config::system_clock().wall_ms() - 900'000;
  for (int i = 0; i < 100; ++i) publisher->publish(message(std::to_string(i), "one", old));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_backlog") == 90; })) << "10 are in the topology";
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_arrival_age_seconds") >= 900; }));
  const auto arrivals = nlohmann::json::parse(worker.describe()).at("arrivals").at(0);
  EXPECT_EQ(arrivals.at("component"), "in");
  EXPECT_EQ(arrivals.at("backlog"), 90);
  EXPECT_EQ(arrivals.at("most"), 90);
  EXPECT_EQ(arrivals.at("topic"), topic("one", "up"));
  EXPECT_GE(arrivals.at("age_s"), 900);
  KeepingBolt::release();
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_backlog") == 0; }));
  publisher->publish(message("now", "one", config::system_clock().wall_ms()));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_arrival_age_seconds") < 900; }));
}

TEST_F(WorkerSays, NothingOfMessagesThatDidNotComeAndOfBrokersThatWereNotAsked) {
  const Worker& worker = run();
  const auto arrivals = nlohmann::json::parse(worker.describe()).at("arrivals").at(0);
  EXPECT_EQ(arrivals.at("age_s"), nullptr);
  EXPECT_EQ(arrivals.at("backlog"), nullptr);
}

TEST_F(WorkerSays, InTheLogWhatAWindowKeepsWhenItStops) {
  ComponentRegistry components;
  components.add_bolt("Window", make_windowed_bolt<KeepingWindow>({.length = WindowExtent(1h)}));
  Worker& worker = run_yaml(
      "topology.name: t\nruntime: {message_timeout: 2h}\n"
      "spouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time]}\n"
      "bolts:\n  mean: {class: Window, inputs: {from: in}}\n",
      std::move(components));
  show_driver("one");
  const auto publisher = device("one");
  for (int i = 0; i < 3; ++i) publisher->publish(message(std::to_string(i), "one"));
  ASSERT_TRUE(eventually([&] { return worker.snapshot().component("mean").executed == 3; }));
  const tests::CapturedLog log;
  worker.stop(100ms);
  EXPECT_THAT(log.text(),
              HasSubstr("topology t: the 50 ms to finish what was under way are over; tuples under way: 3 of "
                        "in; these bolts keep tuples by design until a window or checkpoint ends: mean (for "
                        "up to 3600000 ms); spouts that acknowledge read them again"));
}

/// Whether tuples record their birth in a topology with more bolts than one.
class WorkersTuples : public Endpoints {
 protected:
  bool are_born(const std::string& more) {
    ComponentRegistry components;
    components.add_bolt<BornBolt>("Born");
    run_yaml(
        "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time]}\n"
        "bolts:\n  born: {class: Born, inputs: {from: in}}\n" +
            more,
        std::move(components));
    show_driver("one");
    EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 1; }));
    BornBolt::born = BornBolt::none_came;
    device("one")->publish(message("1", "one"));
    EXPECT_TRUE(eventually([&] { return BornBolt::born != BornBolt::none_came; }));
    return BornBolt::born != 0;
  }
};

TEST_F(WorkersTuples, RecordTheirBirthForTheFenceOfABoltThatSends) {
  EXPECT_TRUE(are_born(
      "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: born}}\n"));
}

TEST_F(WorkersTuples, RecordNoBirthWithoutABoltThatSends) {
  EXPECT_FALSE(are_born(""));
}

}  // namespace
}  // namespace iotcloud::topology
