#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/drivers/loadgen/load_generator.h>
#include <iotcloud/drivers/testing/mock_host.h>

namespace iotcloud::drivers::loadgen {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;
using testing::MockInstance;

/// The driver, with the mock host's simulated time as its clock.
class LoadGeneratorTest : public ::testing::Test {
 protected:
  struct Simulated : LoadGenerator {
    Simulated() : LoadGenerator([] { return std::chrono::steady_clock::time_point(host->now()); }) {}
  };
  /// \return a started instance, reporting to report().
  MockInstance& start(PropertyMap properties) {
    properties["report"] = path();
    instance_.emplace(describe<Simulated>("loadgen", "test"), std::move(properties));
    host = &instance_->host();
    EXPECT_TRUE(instance_->start()) << instance_->error();
    return *instance_;
  }
  static std::string path() {
    return (std::filesystem::temp_directory_path() / ("loadgen-" + std::to_string(getpid()) + ".json")).string();
  }
  static nlohmann::json report() { return nlohmann::json::parse(std::ifstream(path())); }
  ~LoadGeneratorTest() override { std::filesystem::remove(path()); }

  static inline testing::MockHost* host = nullptr;
  std::optional<MockInstance> instance_;
};

TEST_F(LoadGeneratorTest, sends_so_many_of_such_a_size_at_such_a_rate) {
  auto& load = start({{"size", "100"}, {"rate", "50"}, {"count", "70"}});
  host->advance(1s);
  EXPECT_EQ(host->published("data").size(), 50);
  host->advance(10s);
  const auto sent = host->published("data");
  EXPECT_EQ(sent.size(), 70);
  for (const auto& published : sent) EXPECT_EQ(published.message.payload.size(), 100);
  load.close();
  EXPECT_EQ(report()["sent"], 70);
  EXPECT_EQ(report()["lost"], 70);
}

TEST_F(LoadGeneratorTest, keeps_odd_and_high_rates) {
  start({{"size", "32"}, {"rate", "2500.5"}});
  host->advance(2s);
  EXPECT_EQ(host->published("data").size(), 5001);
}

TEST_F(LoadGeneratorTest, measures_what_comes_back_from_when_it_was_to_be_sent) {
  auto& load = start({{"rate", "100"}, {"count", "4"}});
  host->advance(10ms);
  const auto first = host->published("data").at(0).message;
  host->advance(5ms);
  ASSERT_TRUE(load.deliver("echo", first));  // after 5 ms
  host->advance(25ms);                       // 3 more were sent, at 20, 30 and 40 ms
  const auto sent = host->published("data");
  ASSERT_EQ(sent.size(), 4);
  ASSERT_TRUE(load.deliver("echo", sent[3].message));  // after 0 ms
  ASSERT_TRUE(load.deliver("echo", sent[1].message));  // after 20 ms, and out of order
  ASSERT_TRUE(load.deliver("echo", sent[1].message));
  load.close();
  const auto json = report();
  EXPECT_EQ(json["sent"], 4);
  EXPECT_EQ(json["received"], 3);
  EXPECT_EQ(json["lost"], 1);
  EXPECT_EQ(json["duplicated"], 1);
  EXPECT_EQ(json["out_of_order"], 1);
  EXPECT_NEAR(json["latency_us"]["p50"].get<double>(), 5000, 100);
  EXPECT_DOUBLE_EQ(json["latency_us"]["max"].get<double>(), 20'000);
  EXPECT_EQ(host->logged_count("round trips"), 1);
}

TEST_F(LoadGeneratorTest, counts_the_time_that_a_full_channel_held_a_message_up) {
  auto& load = start({{"rate", "100"}});
  host->answer_publish("data", PublishStatus::would_block);
  host->advance(50ms);
  EXPECT_TRUE(host->published("data").empty());
  host->answer_publish("data", PublishStatus::accepted);
  host->advance(1ms);
  EXPECT_TRUE(host->published("data").empty());  // it waits for the order
  ASSERT_TRUE(load.writable("data"));
  const auto sent = host->published("data");
  ASSERT_EQ(sent.size(), 5);
  for (const auto& published : sent) ASSERT_TRUE(load.deliver("echo", published.message));
  load.close();
  EXPECT_DOUBLE_EQ(report()["latency_us"]["max"].get<double>(), 41'000);
  EXPECT_EQ(report()["times_blocked"], 1);
  EXPECT_EQ(report()["lost"], 0);
}

TEST_F(LoadGeneratorTest, reports_as_soon_as_all_are_back) {
  auto& load = start({{"rate", "1000"}, {"count", "3"}});
  host->advance(1s);
  for (const auto& published : host->published("data")) ASSERT_TRUE(load.deliver("echo", published.message));
  EXPECT_EQ(report()["received"], 3);
  EXPECT_EQ(report()["latency_us"].size(), 5);
}

TEST_F(LoadGeneratorTest, reports_the_latencies_of_its_warm_up_apart) {
  auto& load = start({{"rate", "100"}, {"count", "4"}, {"warm_up", "2"}});
  host->advance(40ms);  // the messages were due at 10, 20, 30 and 40 ms
  for (const auto& published : host->published("data")) ASSERT_TRUE(load.deliver("echo", published.message));
  EXPECT_EQ(report()["received"], 4);
  EXPECT_DOUBLE_EQ(report()["latency_us"]["max"].get<double>(), 10'000);
  EXPECT_DOUBLE_EQ(report()["warm_up_latency_us"]["max"].get<double>(), 30'000);
}

TEST_F(LoadGeneratorTest, leaves_the_report_that_somebody_reads_as_it_is_when_it_writes_a_newer_one) {
  auto& load = start({{"rate", "1000"}, {"count", "3"}});
  host->advance(1s);
  const auto sent = host->published("data");
  for (const auto& published : sent) ASSERT_TRUE(load.deliver("echo", published.message));
  std::ifstream reader(path());
  ASSERT_TRUE(load.deliver("echo", sent[0].message));  // a late duplicate
  EXPECT_EQ(nlohmann::json::parse(reader)["duplicated"], 0);
  EXPECT_EQ(report()["duplicated"], 1);
  EXPECT_FALSE(std::filesystem::exists(path() + ".unfinished"));
}

TEST_F(LoadGeneratorTest, goes_on_counting_after_a_pause) {
  auto& load = start({{"rate", "10"}});
  host->advance(1s);
  ASSERT_TRUE(load.deactivate());
  host->advance(5s);
  EXPECT_EQ(host->published("data").size(), 10);
  ASSERT_TRUE(load.activate());
  host->advance(1s);
  const auto sent = host->published("data");
  ASSERT_EQ(sent.size(), 20);
  ASSERT_TRUE(load.deliver("echo", sent[0].message));   // 6.9 s old
  ASSERT_TRUE(load.deliver("echo", sent[19].message));  // fresh
  load.close();
  EXPECT_EQ(report()["damaged"], 0);
  EXPECT_DOUBLE_EQ(report()["latency_us"]["max"].get<double>(), 6'900'000);
}

TEST_F(LoadGeneratorTest, tells_damaged_and_foreign_messages_from_its_own) {
  auto& load = start({{"rate", "100"}, {"size", "64"}});
  host->advance(10ms);
  const Message sent = host->published("data").at(0).message;
  const auto changed = [&](std::size_t position) {
    std::string bytes(sent.payload.text());
    bytes[position] = static_cast<char>(bytes[position] ^ 1);
    Message message = sent;
    message.payload = Payload::copy(bytes);
    return message;
  };
  Message shorter = sent;
  shorter.payload = Payload::copy(sent.payload.text().substr(0, 63));
  EXPECT_TRUE(load.deliver("echo", changed(0)));   // magic
  EXPECT_TRUE(load.deliver("echo", changed(8)));   // run: another instance's
  EXPECT_TRUE(load.deliver("echo", changed(17)));  // a sequence number that was never sent
  EXPECT_TRUE(load.deliver("echo", changed(63)));  // filler
  EXPECT_TRUE(load.deliver("echo", shorter));
  EXPECT_TRUE(load.deliver("echo", Message{}));
  load.close();
  EXPECT_EQ(report()["damaged"], 5);
  EXPECT_EQ(report()["foreign"], 1);
  EXPECT_EQ(report()["received"], 0);
}

TEST_F(LoadGeneratorTest, has_shared_channels_when_asked) {
  for (const bool shared : {false, true}) {
    MockInstance load(describe<LoadGenerator>("loadgen", "test"), {{"shared", shared ? "true" : "false"}});
    ASSERT_TRUE(load.open()) << load.error();
    ASSERT_EQ(load.channels().size(), 2);
    EXPECT_EQ(load.channels()[0].name, "data");
    EXPECT_EQ(load.channels()[0].shared, shared);
    EXPECT_EQ(load.channels()[1].name, "echo");
    EXPECT_EQ(load.channels()[1].shared, shared);
    EXPECT_EQ(load.channels()[1].direction, Direction::in);
  }
}

TEST_F(LoadGeneratorTest, says_which_property_is_wrong) {
  const auto error_with = [](const PropertyMap& properties) {
    MockInstance load(describe<LoadGenerator>("loadgen", "test"), properties);
    EXPECT_FALSE(load.open());
    return load.error();
  };
  EXPECT_THAT(error_with({{"siz", "1"}}), HasSubstr("did you mean \"size\"?"));
  EXPECT_THAT(error_with({{"size", "31"}}), HasSubstr("from 32"));
  EXPECT_THAT(error_with({{"shared", "yes"}}), HasSubstr("true or false"));
  EXPECT_THAT(error_with({{"report", "/dev/null/r.json"}}), HasSubstr("/dev/null/r.json"));
}

}  // namespace
}  // namespace iotcloud::drivers::loadgen
