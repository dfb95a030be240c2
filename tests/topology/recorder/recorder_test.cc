#include <atomic>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/replay/replay_driver.h>
#include <iotcloud/recording/recording.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/temporary_folder.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/local/local_cluster.h>
#include <iotcloud/topology/recorder/play.h>
#include <iotcloud/topology/recorder/record.h>
#include <iotcloud/topology/testing/recorded.h>

namespace iotcloud::recorder {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using topology::Values;

constexpr int readings = 40;

brokers::Message message_of(const std::string& text, std::int64_t time_ms = 0) {
  brokers::Message message;
  message.payload = brokers::Payload::copy(text);
  message.time_ms = time_ms;
  return message;
}

/// What a recording has on a channel: payload, time, properties, and the time since the first message.
struct Line {
  std::string text;
  std::int64_t time_ms;
  brokers::Properties properties;
};
std::vector<Line> lines_of(const std::string& file, const std::string& channel = "reading") {
  recording::RecordingReader reader(file);
  std::vector<Line> lines;
  while (const auto read = reader.next()) {
    if (reader.channels()[read->channel].name == channel)
      lines.push_back({std::string(read->message.payload.text()), read->message.time_ms, read->message.properties});
  }
  return lines;
}
void expect_same(const std::vector<Line>& a, const std::vector<Line>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].text, b[i].text);
    EXPECT_EQ(a[i].time_ms, b[i].time_ms);
    EXPECT_EQ(a[i].properties, b[i].properties);
  }
}

class RecorderTest : public ::testing::Test {
 protected:
  RecorderTest() {
    recording::RecordingWriter writer(file_, {});
    const auto reading = writer.add_channel({"replay", "meter-one", "", "lab", "reading"});
    const auto heater = writer.add_channel({"replay", "meter-one", "", "lab", "heater", false});
    for (int i = 0; i < readings; ++i) {
      auto message = message_of("reading " + std::to_string(i), 1'700'000'000'000 + i);
      message.driver_id = "meter-one";
      message.properties.set("unit", "C");
      writer.add(reading, message, 1s + i * 5ms);
      if (i == 0) writer.add(heater, message_of("on"), 1s);
    }
    writer.close();
  }

  static local::LocalOptions options(const std::string& name) {
    static const drivers::Descriptor replay = drivers::describe<drivers::replay::ReplayDriver>("replay", "test");
    local::LocalOptions options;
    options.name = name;
    options.drivers = {{"replay", &replay}};
    return options;
  }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name) << text;
    return folder_ / name;
  }

  const tests::TemporaryFolder folder_;
  const std::string file_ = folder_ / "made.mcap";
};

TEST_F(RecorderTest, RecordsWhatADriverSendsWithAllThatComesWithIt) {
  local::LocalCluster cluster(options("records"));
  System system({.registry = "embedded://records"});
  Recorder recorder(system, {.file = folder_ / "new.mcap"});
  const auto id = cluster.deploy("replay", {{"file", file_}});
  ASSERT_TRUE(tests::eventually([&] {
    recorder.tick();
    return recorder.progress().messages == readings;
  })) << recorder.progress().messages;
  EXPECT_THAT(recorder.progress().troubles, ::testing::IsEmpty());
  recorder.close();
  expect_same(lines_of(folder_ / "new.mcap"), lines_of(file_));
  recording::RecordingReader reader(folder_ / "new.mcap");
  ASSERT_EQ(reader.channels().size(), 1u);  // commands are recorded if one asks for them
  EXPECT_EQ(reader.channels()[0].instance, id.str());
  EXPECT_EQ(reader.channels()[0].gateway, "gateway-1");
  reader.check();
}

TEST_F(RecorderTest, RecordsTheInstancesAndChannelsThatAreChosen) {
  local::LocalCluster cluster(options("chosen"));
  System system({.registry = "embedded://chosen"});
  Recorder none(system, {.file = folder_ / "none.mcap", .where = discovery::Selection::parse("driver == \"other\"")});
  Recorder other(system, {.file = folder_ / "other.mcap", .channels = {"status"}});
  Recorder all(system, {.file = folder_ / "all.mcap", .in = true});
  cluster.deploy("replay", {{"file", file_}});
  ASSERT_TRUE(tests::eventually([&] {
    for (auto* recorder : {&none, &other, &all}) recorder->tick();
    return all.progress().messages == readings;
  }));
  EXPECT_EQ(all.progress().channels, 2u);
  EXPECT_EQ(none.progress().channels, 0u);
  EXPECT_EQ(other.progress().channels, 0u);
  for (auto* recorder : {&none, &other, &all}) recorder->close();
}

std::atomic<int> seen{0};

class Count : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer&) const override {}
  void execute(const topology::Tuple&, topology::BasicOutputCollector&) override { ++seen; }
};

TEST_F(RecorderTest, TakesNothingFromATopology) {
  local::LocalCluster cluster(options("both"));
  topology::ComponentRegistry components;
  components.add_bolt<Count>("test.Count");
  cluster.run_topology(topology::TopologyDefinition::parse(R"(
topology.name: count
spouts: {in: {broker: rabbitmq, driver: replay, channel: reading, fields: [data, driverID]}}
bolts: {count: {class: test.Count, inputs: [{from: in}]}}
)",
                                                           "count.yaml"),
                       components);
  const auto id = cluster.deploy("replay", {{"file", file_}, {"speed", "0"}});
  ASSERT_TRUE(tests::eventually([&] { return seen == readings; })) << seen;
  // The topology reads by now: what comes from here on comes to both.
  System system({.registry = "embedded://both"});
  Recorder recorder(system, {.file = folder_ / "new.mcap"});
  ASSERT_TRUE(tests::eventually([&] { return recorder.progress().channels == 1; }));
  recording::RecordingReader reader(file_);
  play_into(system, reader, {.speed = 0, .to = {{"meter-one", id.str()}}}, {});
  ASSERT_TRUE(tests::eventually([&] {
    recorder.tick();
    return recorder.progress().messages == readings && seen == 2 * readings;
  })) << seen;
  recorder.close();
}

TEST_F(RecorderTest, PlaysIntoTheChannelsOfARunningSystem) {
  local::LocalCluster cluster(options("plays"));
  System system({.registry = "embedded://plays"});
  // An instance with the channels of the recorded one, which has sent all it has to send.
  const auto id = cluster.deploy("replay", {{"file", file_}, {"speed", "0"}});
  Recorder recorder(system, {.file = folder_ / "new.mcap"});
  const auto recorded = [&](std::uint64_t count) {
    return tests::eventually([&] {
      recorder.tick();
      return recorder.progress().messages == count;
    });
  };
  ASSERT_TRUE(recorded(readings));
  recording::RecordingReader reader(file_);
  const auto begin = std::chrono::steady_clock::now();
  const auto result = play_into(system, reader, {.speed = 2, .to = {{"meter-one", id.str()}}}, {});
  EXPECT_GE(std::chrono::steady_clock::now() - begin, (readings - 1) * 5ms / 2);
  EXPECT_EQ(result.played.messages, std::uint64_t{readings});
  EXPECT_EQ(result.confirmed, std::uint64_t{readings});
  EXPECT_THAT(result.others, ::testing::IsEmpty());
  ASSERT_TRUE(recorded(std::uint64_t{2} * readings));
  recorder.close();
  auto lines = lines_of(folder_ / "new.mcap");
  expect_same({lines.begin() + readings, lines.end()}, lines_of(file_));
}

TEST_F(RecorderTest, SaysWhatTheSystemLacks) {
  local::LocalCluster cluster(options("lacks"));
  System system({.registry = "embedded://lacks"});
  recording::RecordingReader reader(file_);
  const auto refusal = [&](const PlayOptions& how) -> std::string {
    try {
      play_into(system, reader, how, {});
    } catch (const config::Error& error) {
      return error.what();
    }
    return "nothing was refused";
  };
  EXPECT_THAT(refusal({}), HasSubstr("the system has no replay meter-one; say what takes its place with --to"));
  EXPECT_THAT(refusal({.instances = {"meter-two"}}), HasSubstr("no instance \"meter-two\" was recorded; there are: "));
  PlayOptions wrong;
  wrong.to = {{"meter-two", "meter/1"}};
  EXPECT_THAT(refusal(wrong), HasSubstr("no instance \"meter-two\" was recorded; there are: "));
  EXPECT_THAT(refusal({.channels = {"sttus"}}),
              HasSubstr("no channel \"sttus\" was recorded; there are: heater, reading"));
  EXPECT_THAT(refusal({.channels = {"heater"}}), HasSubstr("channels to drivers are played with --in"));
}

constexpr const char* echo = R"(
zk.servers: ["127.0.0.1:1"]
topology.name: echo
brokers: {rabbitmq: "amqp://127.0.0.1:1/"}
spouts: {in: {broker: rabbitmq, driver: replay, channel: reading, fields: [data, driverID, time]}}
bolts: {out: {broker: rabbitmq, driver: replay, channel: answers, fields: [data, driverID, time], inputs: {from: in}}}
)";

TEST_F(RecorderTest, PlaysToATopologyWithoutAnyServer) {
  recording::RecordingReader reader(file_);
  std::vector<std::string> news;
  const auto result = play_to_topology(write("echo.yaml", echo), {}, reader, {.speed = 0},
                                       [&](const std::string& line) { news.push_back(line); }, {});
  EXPECT_EQ(result.played.messages, std::uint64_t{readings});
  EXPECT_THAT(news, ElementsAre(HasSubstr("1 instances play to"), "  in: emitted 40", "  out: took 40, emitted 0"));
}

/// Counts the tuples of each second.
class CountSeconds : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(topology::Fields{"count", "driverID", "time"});
  }
  void execute(const topology::Tuple& tuple, topology::BasicOutputCollector& collector) override {
    if (!tuple.is_tick()) {
      ++count_;
      return;
    }
    if (count_ > 0) collector.emit(Values(std::to_string(std::exchange(count_, 0)), "meter-one", std::int64_t{7}));
  }

 private:
  int count_ = 0;
};

TEST_F(RecorderTest, RunsATopologyOnARecordingInSimulatedTime) {
  // An hour of readings, one every 10 minutes, then three in one second.
  recording::RecordingWriter writer(folder_ / "hour.mcap", {});
  for (const char* place : {"roof", "cellar"})
    writer.add_channel({"meter", place, "", "lab", "reading", true, false, {{"place", place}}});
  for (int i = 0; i < 6; ++i) writer.add(0, message_of("x"), 1000h + i * 10min);
  for (int i = 0; i < 3; ++i) writer.add(0, message_of("x"), 1000h + 1h + i * 10ms);
  writer.add(1, message_of("x"), 1000h + 1h);
  writer.close();
  topology::testing::RecordedRun run{.run_for = 2s, .step = 10ms};
  run.components.add_bolt<CountSeconds>("test.CountSeconds");
  const auto completed = topology::testing::run_on_recording(write("count.yaml", R"(
topology.name: count
spouts: {in: {broker: rabbitmq, driver: meter, channel: reading, where: 'place == "roof"', fields: [data, driverID]}}
bolts:
  count: {class: test.CountSeconds, tick: 1s, inputs: [{from: in}]}
  send: {broker: rabbitmq, driver: meter, channel: counts, builder: text, fields: [count, driverID, time], inputs: {from: count}}
)"),
                                                             folder_ / "hour.mcap", run);
  std::vector<std::string> counts;
  for (const auto& tuple : completed.tuples("count")) counts.push_back(std::get<std::string>(tuple[0]));
  EXPECT_THAT(counts, ElementsAre("1", "1", "1", "1", "1", "1", "3"));
  ASSERT_EQ(completed.tuples("send").size(), 7u);
  EXPECT_EQ(std::get<topology::Payload>(completed.tuples("send")[6][1]).text(), "3");
  EXPECT_GE(completed.emitted.back().at, 1h);
}

}  // namespace
}  // namespace iotcloud::recorder
