#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/bench/paper/application/load_driver.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::bench::paper {
namespace {

using drivers::testing::MockInstance;

constexpr std::int64_t patience_ns = 60'000'000'000;

class PaperDriver : public testing::Test {
 protected:
  PaperDriver() { std::filesystem::create_directories(folder); }
  ~PaperDriver() override { std::filesystem::remove_all(folder); }
  /// Orders five messages that are due at once. The report comes when all are back.
  void order(std::uint64_t id, std::size_t size) {
    const std::int64_t now = now_ns();
    std::ofstream(folder + "/part") << id << ' ' << size << " 1000 2 " << now - 5'000'000 << " 0 " << now << " "
                                    << patience_ns;
    std::filesystem::rename(folder + "/part", folder + "/order");
  }
  /// Runs the driver's callbacks until `done` holds.
  template <typename Done>
  bool run_until(Done&& done) {
    return tests::eventually([&] {
      robot.host().run_posted();
      robot.host().advance(std::chrono::seconds(1));
      return done();
    });
  }
  std::string report() const {
    std::ifstream file(folder + "/" + std::to_string(::getpid()) + ".json");
    return {std::istreambuf_iterator<char>(file), {}};
  }

  const std::string folder = testing::TempDir() + "paper-driver-" + std::to_string(::getpid());
  const drivers::Descriptor driver = drivers::describe<LoadDriver>("paper_load", "1.0");
  MockInstance robot{driver, {{"folder", folder}}};
};

TEST_F(PaperDriver, SendsAnOrdersMessagesAndReportsWhatCameBack) {
  ASSERT_TRUE(robot.start()) << robot.error();
  order(1, 100);
  ASSERT_TRUE(run_until([&] { return robot.host().published("data").size() == 5; }));
  EXPECT_EQ(report(), "");
  const auto sent = robot.host().published("data");
  for (const auto& published : sent) {
    EXPECT_EQ(published.message.payload.size(), 100);
    ASSERT_TRUE(robot.deliver("echo", published.message));
  }
  ASSERT_TRUE(run_until([&] { return !report().empty(); }));
  const auto said = nlohmann::json::parse(report());
  EXPECT_EQ(said["order"], 1);
  EXPECT_EQ(said["drivers"], 1);
  EXPECT_EQ(said["n"], 5);
  EXPECT_EQ(said["wrong"], 0);
  EXPECT_GE(said["max_us"], 5000);  // from the intended time, which was 5 ms ago
}

TEST_F(PaperDriver, TellsRepeatedAndChangedMessagesFromGoodOnes) {
  ASSERT_TRUE(robot.start()) << robot.error();
  order(1, 100);
  ASSERT_TRUE(run_until([&] { return robot.host().published("data").size() == 5; }));
  const auto sent = robot.host().published("data");
  for (const auto& published : sent) robot.deliver("echo", published.message);
  robot.deliver("echo", sent[2].message);
  ASSERT_TRUE(run_until([&] { return !report().empty(); }));
  robot.host().forget_published();
  order(2, 200);
  ASSERT_TRUE(run_until([&] { return robot.host().published("data").size() == 5; }));
  robot.deliver("echo", sent[0].message);  // it belongs to the previous order: not counted
  const auto second = robot.host().published("data");
  drivers::Message cut = second[0].message;
  cut.payload = drivers::Payload::copy(cut.payload.bytes().first(150));
  robot.deliver("echo", cut);
  for (const auto& published : second) robot.deliver("echo", published.message);
  ASSERT_TRUE(run_until([&] { return nlohmann::json::parse(report())["order"] == 2; }));
  const auto said = nlohmann::json::parse(report());
  EXPECT_EQ(said["n"], 5);
  EXPECT_EQ(said["wrong"], 1);
}

TEST_F(PaperDriver, WaitsWhileItsChannelIsFull) {
  ASSERT_TRUE(robot.start()) << robot.error();
  robot.host().answer_publish("data", drivers::PublishStatus::would_block);
  order(1, 100);
  const auto joined = [&] { return robot.host().run_posted() > 0; };
  ASSERT_TRUE(tests::eventually(joined));
  robot.host().advance(std::chrono::seconds(1));
  EXPECT_TRUE(robot.host().published("data").empty());
  robot.host().answer_publish("data", drivers::PublishStatus::accepted);
  ASSERT_TRUE(robot.writable("data"));
  EXPECT_EQ(robot.host().published("data").size(), 5);
}

TEST_F(PaperDriver, NeedsAFolder) {
  MockInstance lost(driver, {});
  EXPECT_FALSE(lost.start());
  EXPECT_THAT(lost.error(), testing::HasSubstr("\"folder\""));
}

}  // namespace
}  // namespace iotcloud::bench::paper
