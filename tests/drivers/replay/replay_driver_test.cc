#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/drivers/replay/replay_driver.h>
#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::replay {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::MockInstance;

/// The driver, with the mock host's simulated time as its clock.
class ReplayDriverTest : public ::testing::Test {
 protected:
  struct Simulated : ReplayDriver {
    Simulated() : ReplayDriver([] { return std::chrono::steady_clock::time_point(host->now()); }) {}
  };

  /// Two meters with two channels out and one in. Each meter sends every 100 ms, the second 50 ms after the first.
  ReplayDriverTest() {
    recording::RecordingWriter writer(file_, {});
    for (const char* instance : {"meter-one", "meter-two"}) {
      for (const char* channel : {"reading", "status", "heater"}) {
        writer.add_channel({"meter",
                            instance,
                            instance == std::string("meter-one") ? "meter/1" : "meter/2",
                            "lab",
                            channel,
                            channel != std::string("heater"),
                            false,
                            {{"place", instance}}});
      }
    }
    for (int i = 0; i < 10; ++i) {
      add(writer, i * 100ms, 0, "one " + std::to_string(i));
      add(writer, i * 100ms + 20ms, 2, "a command");
      add(writer, i * 100ms + 50ms, 3, "two " + std::to_string(i));
      if (i == 5) add(writer, 560ms, 1, "status");
    }
    writer.close();
  }
  static void add(recording::RecordingWriter& writer, std::chrono::nanoseconds at, std::size_t channel,
                  const std::string& text) {
    Message message;
    message.driver_id = channel < 3 ? "meter-one" : "meter-two";
    message.payload = Payload::copy(text);
    message.time_ms = 1'000 + std::chrono::duration_cast<std::chrono::milliseconds>(at).count();
    message.properties.set("unit", "C");
    writer.add(channel, message, 1h + at);
  }

  MockInstance& make(PropertyMap properties) {
    properties.try_emplace("file", file_);
    instance_.emplace(describe<Simulated>("replay", "test"), std::move(properties));
    host = &instance_->host();
    return *instance_;
  }
  MockInstance& start(PropertyMap properties) {
    EXPECT_TRUE(make(std::move(properties)).start()) << instance_->error();
    return *instance_;
  }
  std::vector<std::string> sent(const std::string& channel = "reading") {
    std::vector<std::string> texts;
    for (const auto& published : host->published(channel)) texts.emplace_back(published.message.payload.text());
    return texts;
  }

  const tests::TemporaryFolder folder_;
  const std::string file_ = folder_ / "a.mcap";
  static inline testing::MockHost* host = nullptr;
  std::optional<MockInstance> instance_;
};

TEST_F(ReplayDriverTest, LetsOthersOfItsHostHaveTheirTurnWhileItPassesOverMessages) {
  const std::string file = folder_ / "long.mcap";
  {
    recording::RecordingWriter writer(file, {});
    for (const char* instance : {"meter-one", "meter-two"}) writer.add_channel({"meter", instance, "", "", "reading"});
    Message message;
    message.driver_id = "meter-one";
    for (int i = 0; i < 15'000; ++i) writer.add(0, message, 1s);
    message.driver_id = "meter-two";
    writer.add(1, message, 2s);
    writer.close();
  }
  start({{"file", file}, {"instance", "meter-two"}});
  EXPECT_TRUE(sent().empty()) << "the others were not read at once";
  host->advance(0ms);
  EXPECT_EQ(sent().size(), 1u);
}

TEST_F(ReplayDriverTest, SendsWhatOneInstanceSentAtItsOwnPace) {
  start({{"instance", "meter/1"}});
  EXPECT_EQ(sent().size(), 1u);
  host->advance(299ms);
  EXPECT_THAT(sent(), ElementsAre("one 0", "one 1", "one 2"));
  host->advance(1ms);
  EXPECT_THAT(sent().back(), "one 3");
  host->advance(10s);
  EXPECT_EQ(sent().size(), 10u);
  EXPECT_THAT(sent("status"), ElementsAre("status"));
  const auto message = host->published("reading")[2].message;
  EXPECT_EQ(message.time_ms, 1'200);
  EXPECT_EQ(*message.properties.find("unit"), "C");
  EXPECT_EQ(host->metadata()["place"], "meter-one");
  EXPECT_EQ(host->logged_count("the recording has ended: 11 messages"), 1u);
}

TEST_F(ReplayDriverTest, HasTheChannelsOfTheRecordedInstance) {
  auto& replay = start({{"instance", "meter-two"}});
  ASSERT_EQ(replay.channels().size(), 1u);  // messages of the others were not recorded
  EXPECT_EQ(replay.channels()[0].name, "reading");
  auto& other = start({{"instance", "meter-one"}});
  ASSERT_EQ(other.channels().size(), 3u);
  EXPECT_TRUE(other.deliver("heater", Message()));
}

TEST_F(ReplayDriverTest, PlaysAtAnotherSpeedAndAgainAndAgain) {
  start({{"instance", "meter/2"}, {"speed", "10"}, {"loop", "true"}});
  host->advance(89ms);
  EXPECT_EQ(sent().size(), 9u);
  host->advance(1ms);
  EXPECT_EQ(sent().size(), 11u);  // the last one, and the first of the second round
  host->advance(90ms);
  EXPECT_EQ(sent().size(), 21u);
}

TEST_F(ReplayDriverTest, AtSpeedZeroSendsAllWithoutWaiting) {
  start({{"instance", "meter/1"}, {"speed", "0"}, {"times", "now"}});
  host->advance(1us);
  EXPECT_EQ(sent().size(), 10u);
}

TEST_F(ReplayDriverTest, LeavesNothingOutWhenTheChannelIsFullOrTheInstancePauses) {
  auto& replay = start({{"instance", "meter/1"}});
  host->answer_publish("reading", PublishStatus::would_block);
  host->advance(450ms);
  EXPECT_EQ(sent().size(), 1u);
  host->answer_publish("reading", PublishStatus::accepted);
  EXPECT_TRUE(replay.writable("reading"));
  EXPECT_EQ(sent().size(), 5u);  // those that were due meanwhile
  EXPECT_TRUE(replay.deactivate());
  host->advance(10s);
  EXPECT_EQ(sent().size(), 5u);
  EXPECT_TRUE(replay.activate());
  host->advance(400ms);  // goes on with the next one at once, and keeps the distance of those after it
  EXPECT_EQ(sent().size(), 10u);
}

TEST_F(ReplayDriverTest, SaysWhichInstancesThereAre) {
  EXPECT_FALSE(make({}).start());
  EXPECT_THAT(instance_->error(),
              HasSubstr("several instances were recorded; say which: meter/1 (meter-one), meter/2"));
  EXPECT_FALSE(make({{"instance", "meter/3"}}).start());
  EXPECT_THAT(instance_->error(), HasSubstr("no instance \"meter/3\" was recorded; there are: meter/1"));
  EXPECT_FALSE(make({{"file", "/none.mcap"}}).start());
  EXPECT_THAT(instance_->error(), HasSubstr("/none.mcap cannot be read"));
  EXPECT_FALSE(make({{"sped", "2"}}).start());
  EXPECT_THAT(instance_->error(), HasSubstr("sped"));
}

TEST_F(ReplayDriverTest, PlaysRecordingsOfOtherPrograms) {
  start({{"file", std::string(RECORDINGS) + "/lz4.mcap"}, {"speed", "0"}});
  host->advance(1us);
  EXPECT_EQ(sent("meter.1").size() + sent("meter.2").size() + sent("raw").size(), 30u);
}

}  // namespace
}  // namespace iotcloud::drivers::replay
