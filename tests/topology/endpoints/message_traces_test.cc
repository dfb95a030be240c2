#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/clock_name.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/receiving/message_traces.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/worker/page_requests.h>

namespace iotcloud::topology {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

class MessageTracesTest : public ::testing::Test {
 protected:
  static brokers::Message message(std::int64_t time_ms, const std::string& driver = "one") {
    brokers::Message made;
    made.driver_id = driver;
    made.time_ms = time_ms;
    return made;
  }
  auto poll(const std::string& id = "a", std::int64_t every_ms = 100) { return traces_.poll({id, "one", every_ms}); }

  tests::HandClock clock_;
  MessageTraces traces_{clock_};
};

TEST_F(MessageTracesTest, ChooseTheFirstMessageOfEachSpanOfEachTopic) {
  EXPECT_FALSE(traces_.any());
  poll();
  EXPECT_TRUE(traces_.any());
  for (const std::int64_t time : {100, 150, 199, 200, 350}) traces_.came(message(time), "up", "");
  traces_.came(message(150, ""), "other", "one");
  traces_.came(message(400, "two"), "up", "");
  EXPECT_TRUE(poll().ways.empty()) << "none is done";
  clock_.advance(MessageTraces::longest_way);
  const auto ways = poll().ways;
  std::vector<std::pair<std::string, std::int64_t>> chosen;
  for (const auto& way : ways) chosen.emplace_back(way.topic, way.time_ms);
  EXPECT_THAT(chosen, testing::ElementsAre(testing::Pair("up", 100), testing::Pair("up", 200), testing::Pair("up", 350),
                                           testing::Pair("other", 150)));
  EXPECT_EQ(ways[0].outcome, "") << "it is told unfinished after a while";
}

TEST_F(MessageTracesTest, EndWhenNobodyAsksAndSayWhenTheyBegin) {
  std::vector<bool> changes;
  traces_.on_change([&](bool any) { changes.push_back(any); });
  poll("a");
  poll("b");
  traces_.end("a");
  EXPECT_THAT(changes, testing::ElementsAre(true));
  clock_.advance(MessageTraces::patience);
  traces_.came(message(1), "up", "");
  EXPECT_FALSE(traces_.any());
  EXPECT_THAT(changes, testing::ElementsAre(true, false));
}

TEST_F(MessageTracesTest, AreBounded) {
  for (std::size_t i = 0; i < MessageTraces::most_questions; ++i) poll(std::to_string(i));
  EXPECT_THAT([&] { poll("one more"); },
              testing::ThrowsMessage<std::invalid_argument>(HasSubstr("which is the limit")));
  for (std::size_t i = 0; i < MessageTraces::most_kept + 3; ++i)
    traces_.came(message(static_cast<std::int64_t>(100 * i)), "up", "");
  clock_.advance(MessageTraces::longest_way);
  const auto answer = poll("0");
  EXPECT_EQ(answer.ways.size(), MessageTraces::most_kept);
  EXPECT_EQ(answer.missed, 3U);
  EXPECT_THAT(
      [&] {
        traces_.poll({"x", "", 1});
      },
      testing::ThrowsMessage<std::invalid_argument>(HasSubstr("instance")));
  EXPECT_THAT(
      [&] {
        traces_.poll({"x", "one", 0});
      },
      testing::ThrowsMessage<std::invalid_argument>(HasSubstr("every_ms")));
}

TEST_F(MessageTracesTest, AreBoundedWhateverTimesADeviceGives) {
  poll("a", 1);
  for (std::size_t i = 0; i < MessageTraces::most_followed + 100; ++i)
    traces_.came(message(static_cast<std::int64_t>(i)), "up", "");
  const auto follows = [&](std::size_t time) {
    return traces_.take(message(static_cast<std::int64_t>(time)), "up", "spout", false) != nullptr;
  };
  EXPECT_TRUE(follows(MessageTraces::most_followed - 1));
  EXPECT_FALSE(follows(MessageTraces::most_followed));
  EXPECT_EQ(poll("a", 1).missed, MessageTraces::most_followed - MessageTraces::most_kept + 100);
}

TEST_F(MessageTracesTest, KeepNoMoreStepsThanTheirLimitAndCountTheOthers) {
  MessageTrace trace(message(1), "one", "up", 5);
  ASSERT_TRUE(trace.take("in", 6, false));
  EXPECT_FALSE(trace.take("in", 7, false)) << "another message of the same time is not followed as this one";
  detail::StreamInfo stream{"in", default_stream, Fields{"x"}};
  TopologyContext context;
  context.component = "bolt";
  struct Data final : detail::TupleData {
    void recycle() noexcept override {}
  };
  std::vector<Data> tuples(MessageWay::most_steps + 2);
  for (auto& tuple : tuples) {
    tuple.stream = &stream;
    trace.emitted(context, tuple, 10);
    trace.executed(context, tuple, 20, 30);
    trace.settled(context, tuple, 40, true);
  }
  const auto way = trace.way();
  ASSERT_EQ(way.steps.size(), MessageWay::most_steps);
  EXPECT_EQ(way.steps[0].emitted_ns, 10);
  EXPECT_EQ(way.steps[0].settled_ns, 40);
  EXPECT_EQ(way.more_steps, 2U);
}

json page_of(Worker& worker, const std::string& driver = "one") {
  return json::parse(trace_page(worker, {{"id", "test"}, {"driver", driver}, {"every_ms", "1"}}));
}

TEST_F(Endpoints, FollowMessagesThroughTheTasksWhileSomebodyAsks) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  Worker& worker = run();
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("before", "one", 1));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_TRUE(page_of(worker)["ways"].empty()) << "nobody had asked";
  publisher->publish(message("hello", "one", 1234));
  ASSERT_TRUE(mailbox.wait_for(2));
  ASSERT_TRUE(eventually([&] { return worker.snapshot().component("in").acked == 2; })) << "its way has an end";
  json page;
  ASSERT_TRUE(eventually([&] {
    page = page_of(worker);
    return !page["ways"].empty();
  }));
  EXPECT_EQ(page["clock"], config::system_clock_name());
  EXPECT_EQ(page["worker"], worker.name());
  const json way = page["ways"][0];
  EXPECT_EQ(way["time_ms"], 1234);
  EXPECT_EQ(way["topic"], topic("one", "up"));
  EXPECT_EQ(way["spout"], "in");
  EXPECT_EQ(way["outcome"], "acked");
  EXPECT_EQ(way["tries"], 1);
  ASSERT_EQ(way["steps"].size(), 2U) << way;
  const json gate = way["steps"][0], out = way["steps"][1];
  EXPECT_EQ(gate["component"], "gate");
  EXPECT_EQ(gate["from"], "in");
  EXPECT_EQ(out["component"], "out");
  EXPECT_EQ(out["from"], "gate");
  EXPECT_TRUE(out["acked"]);
  const std::vector<double> times{way["came_us"],    way["taken_us"], gate["emitted_us"], gate["begin_us"],
                                  out["emitted_us"], gate["end_us"],  out["begin_us"],    out["end_us"],
                                  out["settled_us"], way["done_us"]};
  EXPECT_TRUE(std::is_sorted(times.begin(), times.end())) << page.dump(1);
  EXPECT_GT(times.front(), 0);
  trace_page(worker, {{"id", "test"}, {"end", "1"}});
  EXPECT_FALSE(worker.traces().any());
  EXPECT_THAT(
      [&] {
        trace_page(worker, {{"id", "a"}, {"driver", "one"}, {"every_ms", "soon"}});
      },
      testing::ThrowsMessage<std::invalid_argument>(HasSubstr("every_ms is no number: \"soon\"")));
}

TEST_F(Endpoints, SayOfMessagesOfASpoutThatAcksAtOnceThatTheyAreNotFollowed) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  Worker& worker = run("{ackMode: auto}");
  show_driver("one");
  const auto publisher = device("one");
  page_of(worker);
  publisher->publish(message("hello", "one", 1234));
  ASSERT_TRUE(mailbox.wait_for(1));
  json page;
  ASSERT_TRUE(eventually([&] {
    page = page_of(worker);
    return !page["ways"].empty();
  }));
  EXPECT_EQ(page["ways"][0]["outcome"], "not followed");
}

TEST_F(Endpoints, CountTheTriesOfAMessageThatIsFollowed) {
  struct FailsOnce final : Bolt {
    void prepare(const Config&, const TopologyContext&, OutputCollector& to) override { collector = &to; }
    void execute(const Tuple& tuple) override {
      if (std::exchange(failed, true)) {
        collector->ack(tuple);
      } else {
        collector->fail(tuple);
      }
    }
    OutputCollector* collector = nullptr;
    bool failed = false;
  };
  ComponentRegistry components;
  components.add_bolt<FailsOnce>("FailsOnce");
  Worker& worker = run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID], builder: "
      "text}\n"
      "bolts:\n  once: {class: FailsOnce, inputs: {from: in}}\n",
      std::move(components));
  show_driver("one");
  const auto publisher = device("one");
  page_of(worker);
  publisher->publish(message("hello", "one", 1234));
  // Before it asks, because after 2 s a page shows also a way that has no end yet.
  ASSERT_TRUE(eventually([&] { return worker.snapshot().component("in").acked == 1; }));
  json ways = json::array();
  ASSERT_TRUE(eventually([&] {
    ways = page_of(worker)["ways"];
    return !ways.empty();
  }));
  EXPECT_EQ(ways[0]["tries"], 2) << ways;
  EXPECT_EQ(ways[0]["outcome"], "acked");
  ASSERT_EQ(ways[0]["steps"].size(), 2U) << ways;
  EXPECT_FALSE(ways[0]["steps"][0]["acked"]);
  EXPECT_TRUE(ways[0]["steps"][1]["acked"]);
}

}  // namespace
}  // namespace iotcloud::topology
