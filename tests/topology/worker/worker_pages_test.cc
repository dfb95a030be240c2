#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/tests/topology/state/counting.h>
#include <iotcloud/tests/topology/state/state_fixture.h>
#include <iotcloud/tests/topology/windows/windows_fixture.h>
#include <iotcloud/topology/worker/pages.h>

namespace iotcloud::topology::workshop {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using testing::SizeIs;

/// in -> pass (of 2 tasks, 1 at a time) -> out, which fails what is negative.
struct Paged {
  Paged() {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(source, Fields{"value", "data"}));
    builder.set_bolt("pass", pass_bolt(Fields{"value", "data"})).tasks(2).fields_grouping("in", Fields{"value"});
    builder
        .set_bolt("out", bolt([](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                    if (tuple.get<std::int64_t>("value") < 0) throw std::runtime_error("no negative numbers");
                    collector.ack(tuple);
                  }))
        .shuffle_grouping("pass");
    runtime = std::make_unique<Runtime>(builder.build("paged"), bench.options());
    runtime->start();
    desk.emplace(*runtime, TapDesk::Options{.clock = &bench.clock, .most_taps = 2, .most_samples = 3});
  }
  void put(std::int64_t from, std::int64_t to) {
    for (auto i = from; i <= to; ++i) source->lay(Values(i, Payload::copy("0123456789abcdefXYZ")));
    source->wake();
    runtime->run_until_idle();
  }
  json samples(const std::string& id, const std::string& component, const std::string& stream = "") {
    return json::parse(desk->poll(id, component, stream, 1e9));
  }
  Bench bench;
  std::shared_ptr<Source> source = std::make_shared<Source>();
  std::unique_ptr<Runtime> runtime;
  std::optional<TapDesk> desk;
};

json task_of(const json& page, const std::string& component) {
  json sum;
  for (const auto& task : page["tasks"]) {
    if (task["component"] != component) continue;
    for (const auto& [key, value] : task.items()) {
      if (value.is_number_integer() && sum.contains(key)) {
        sum[key] = sum[key].get<std::int64_t>() + value.get<std::int64_t>();
      } else {
        sum[key] = value;
      }
    }
  }
  return sum;
}

TEST(WorkerPages, SayWhatHindersComponentsAsLongAsItDoes) {
  Paged paged;
  TroubleBoard board;
  auto options = paged.bench.options();
  options.troubles = &board;
  Troubles* of_pass = nullptr;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(paged.source));
  builder
      .set_bolt("pass", bolt([&](const Tuple& tuple, OutputCollector& collector, const TopologyContext& context) {
                  of_pass = context.troubles;
                  collector.ack(tuple);
                }))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("hindered"), options);
  runtime.start();
  runtime.run_until_idle();
  paged.source->put(Values(std::int64_t{1}));
  runtime.run_until_idle();
  ASSERT_EQ(of_pass, &board);
  EXPECT_EQ(json::parse(describe(runtime, "w1"))["troubles"], json::array());
  for (const char* part : {"1", "2"}) of_pass->set("pass", part, "the store is away");
  of_pass->set("in", "", "no partition");
  EXPECT_EQ(
      json::parse(describe(runtime, "w1"))["troubles"],
      (json{{{"component", "in"}, {"text", "no partition"}}, {{"component", "pass"}, {"text", "the store is away"}}}));
  EXPECT_EQ(board.line(), "in: no partition; pass: the store is away");
  of_pass->set("pass", "1", "");
  EXPECT_EQ(board.list().size(), 2U) << "the other task's is still there";
  of_pass->set("pass", "2", "");
  of_pass->set("in", "", "");
  EXPECT_EQ(board.line(), "");
}

/// Emits how many tuples a window has.
struct Sizes final : WindowedBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"size"}); }
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector& collector) override { out = &collector; }
  void execute(const TupleWindow& window) override {
    out->emit(Values(static_cast<std::int64_t>(window.tuples().size())));
  }
  WindowOutputCollector* out = nullptr;
};

TEST(WorkerPages, SayHowMuchWindowsAndStatesKeep) {
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  const Folder folder;
  Bench bench;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("count", make_stateful_bolt<Count>({.store = folder.url(), .checkpoint = 100ms}))
      .fields_grouping("in", Fields{"value"});
  builder.set_bolt("window", make_windowed_bolt<Sizes>({.length = 3, .slide = 1})).global_grouping("count");
  builder.set_bolt("out", sink_bolt(sink)).global_grouping("window");
  Runtime runtime(builder.build("keeping"), bench.options());
  runtime.start();
  for (const char* word : {"a", "bb", "a", "ccc"}) source->lay(Values(std::string(word)));
  source->wake();
  runtime.run_until_idle();
  bench.clock.advance(10s);  // bytes are added up now and then
  runtime.run_due_timers();
  runtime.run_until_idle();
  const auto page = json::parse(describe(runtime, "w1"));
  EXPECT_EQ(task_of(page, "window")["window_tuples"], 2) << "those of the last window that the next one has, too";
  EXPECT_EQ(task_of(page, "window")["state_entries"], json());
  EXPECT_EQ(task_of(page, "count")["state_entries"], 3);
  EXPECT_GE(task_of(page, "count")["state_bytes"], 6) << "keys and values";
  EXPECT_EQ(task_of(page, "count")["window_tuples"], json());
}

TEST(WorkerPages, SayWhatABoltDidWithEachOfSeveralInputs) {
  auto source = std::make_shared<Source>();
  Bench bench;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder
      .set_bolt("join", bolt([](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                  if (tuple.get<std::int64_t>("value") == 3) throw std::runtime_error("three");
                  collector.ack(tuple);
                }))
      .shuffle_grouping("in")
      .shuffle_grouping("pass");
  Runtime runtime(builder.build("joins"), bench.options());
  runtime.start();
  for (int i = 0; i < 5; ++i) source->put(Values(i));
  runtime.run_until_idle();
  const auto page = json::parse(describe(runtime, "w1"));
  json one{{"from", "in"}, {"stream", "default"}, {"executed", 5}, {"acked", 4}, {"failed", 1}, {"late", 0}};
  json other = one;
  other["from"] = "pass";
  EXPECT_EQ(task_of(page, "join")["inputs"], (json{one, other}));
  EXPECT_EQ(task_of(page, "pass")["inputs"], json::array());
}

TEST(WorkerPages, DescribeTheGraphAndCountWhatWasDone) {
  Paged paged;
  paged.put(-1, 8);
  const auto page = json::parse(describe(*paged.runtime, "w1"));
  EXPECT_EQ(page["topology"], "paged");
  EXPECT_EQ(page["worker"], "w1");
  EXPECT_EQ(page["active"], true);
  ASSERT_THAT(page["components"], SizeIs(3));
  const auto& pass = page["components"][1];
  EXPECT_EQ(pass["id"], "pass");
  EXPECT_EQ(pass["kind"], "bolt");
  EXPECT_EQ(pass["parallelism"], 1);
  EXPECT_EQ(pass["tasks"], 2);
  EXPECT_EQ(pass["inputs"][0],
            (json{{"from", "in"}, {"stream", "default"}, {"grouping", "fields"}, {"fields", {"value"}}}));
  EXPECT_EQ(pass["streams"]["default"], (json{"value", "data"}));
  ASSERT_THAT(page["tasks"], SizeIs(4));
  EXPECT_EQ(task_of(page, "in")["emitted"], 10);
  EXPECT_EQ(task_of(page, "in")["acked"], 9);
  EXPECT_EQ(task_of(page, "in")["failed"], 1);
  EXPECT_EQ(task_of(page, "pass")["executed"], 10);
  EXPECT_EQ(task_of(page, "out")["failed"], 1);
  EXPECT_EQ(task_of(page, "out")["errors"], 1);
  EXPECT_THAT(task_of(page, "out")["last_error"].get<std::string>(), HasSubstr("no negative numbers"));
  EXPECT_EQ(task_of(page, "out")["execute"]["count"], 10);
}

TEST(WorkerPages, ShowTuplesReadablyWithPayloadsAsSizeAndFirstBytes) {
  Paged paged;
  paged.samples("a", "in");
  paged.put(7, 7);
  const auto page = paged.samples("a", "in");
  ASSERT_THAT(page["samples"], SizeIs(1));
  const auto& sample = page["samples"][0];
  EXPECT_EQ(sample["task"], 1);
  EXPECT_EQ(sample["source"], "in");
  EXPECT_EQ(sample["stream"], "default");
  EXPECT_EQ(sample["fields"]["value"], 7);
  EXPECT_EQ(sample["fields"]["data"]["bytes"], 19);
  EXPECT_EQ(sample["fields"]["data"]["hex"], "30 31 32 33 34 35 36 37 38 39 61 62 63 64 65 66");
  EXPECT_EQ(sample["fields"]["data"]["text"], "0123456789abcdefXYZ") << "it is text";
}

TEST(WorkerTaps, ShowAsManyBytesOfPayloadsAsWereAskedFor) {
  Paged paged;
  const auto samples = [&] { return json::parse(paged.desk->poll("a", "in", "", 1e9, 18)); };
  samples();
  paged.put(7, 7);
  EXPECT_EQ(samples()["samples"][0]["fields"]["data"]["hex"], "30 31 32 33 34 35 36 37 38 39 61 62 63 64 65 66 58 59");
}

TEST(WorkerTaps, KeepNoMoreBytesThanTheyMayButTheLatestSample) {
  Paged paged;
  paged.desk.emplace(*paged.runtime, TapDesk::Options{.clock = &paged.bench.clock, .most_sample_bytes = 10});
  paged.samples("a", "in");
  for (int i = 1; i <= 3; ++i) {
    paged.bench.clock.advance(1s);
    paged.put(i, i);
  }
  const auto page = paged.samples("a", "in");
  ASSERT_THAT(page["samples"], SizeIs(1));
  EXPECT_EQ(page["samples"][0]["fields"]["value"], 3);
  EXPECT_EQ(page["missed"], 2);
}

TEST(WorkerTaps, GiveEachSampleOnceAndKeepTheNewestWhenNobodyFetches) {
  Paged paged;
  paged.samples("a", "pass");
  for (int i = 1; i <= 5; ++i) {
    paged.bench.clock.advance(1s);
    paged.put(i, i);
  }
  const auto page = paged.samples("a", "pass");
  ASSERT_THAT(page["samples"], SizeIs(3));
  EXPECT_EQ(page["samples"][2]["fields"]["value"], 5);
  EXPECT_EQ(page["missed"], 2);
  EXPECT_THAT(paged.samples("a", "pass")["samples"], SizeIs(0));
}

TEST(WorkerTaps, ShowOnlyTheStreamThatWasAskedFor) {
  Paged paged;
  paged.samples("a", "in", "default");
  paged.samples("b", "in", "other");
  paged.put(1, 1);
  EXPECT_THAT(paged.samples("a", "in")["samples"], SizeIs(1));
  EXPECT_THAT(paged.samples("b", "in")["samples"], SizeIs(0));
}

TEST(WorkerTaps, EndWhenAskedToAndWhenNobodyPollsAnyMore) {
  Paged paged;
  paged.samples("a", "in");
  paged.samples("b", "in");
  paged.desk->end("a");
  EXPECT_EQ(paged.desk->open(), 1U);
  paged.bench.clock.advance(4s);
  paged.desk->expire();
  EXPECT_EQ(paged.desk->open(), 1U);
  paged.samples("b", "in");  // still there
  paged.bench.clock.advance(4s);
  paged.desk->expire();
  EXPECT_EQ(paged.desk->open(), 1U);
  paged.bench.clock.advance(2s);
  paged.desk->expire();
  EXPECT_EQ(paged.desk->open(), 0U);
}

TEST(WorkerTaps, AreRefusedWithWhatIsPossible) {
  Paged paged;
  EXPECT_THROW(paged.desk->poll("a", "nowhere", "", 1), std::invalid_argument);
  EXPECT_THROW(paged.desk->poll("a", "in", "", 0), std::invalid_argument);
  EXPECT_EQ(paged.desk->open(), 0U);
  paged.samples("a", "in");
  paged.samples("b", "in");
  try {
    paged.samples("c", "in");
    FAIL() << "a third one was opened";
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), HasSubstr("2 taps are open"));
  }
}

}  // namespace
}  // namespace iotcloud::topology::workshop
