#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/recording/player.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::recording {
namespace {

using namespace std::chrono_literals;

TEST(Pace, IsTheRecordedOneTimesTheSpeed) {
  const auto begin = Pace::Clock::time_point(1h);
  const Instant first(10s);
  EXPECT_EQ(Pace(first, begin, 1).due(12s), begin + 2s);
  EXPECT_EQ(Pace(first, begin, 4).due(12s), begin + 500ms);
  EXPECT_EQ(Pace(first, begin, 0.5).due(12s), begin + 4s);
  EXPECT_EQ(Pace(first, begin, 0).due(12s), begin);
  EXPECT_EQ(Pace(first, begin, 1).due(9s), begin);
  EXPECT_GT(Pace(first, begin, 1e-9).due(Instant(INT64_MAX)), begin);
}

class Player : public ::testing::Test {
 protected:
  Player() {
    RecordingWriter writer(folder_ / "a.mcap", {});
    for (const char* name : {"a", "b"}) writer.add_channel({"meter", "1", "", "lab", name});
    for (int i = 0; i < 20; ++i) {
      brokers::Message message;
      message.driver_id = "1";
      message.payload = brokers::Payload::copy(std::to_string(i));
      writer.add(static_cast<std::size_t>(i % 2), message, i * 10ms);
    }
    writer.close();
    reader_.emplace(folder_ / "a.mcap");
  }
  Played run(double speed, const std::function<bool(const RecordedMessage&)>& chosen) {
    return play(
        *reader_, speed, chosen, [this](RecordedMessage message) { handed_.push_back(std::move(message)); },
        stop_.get_token());
  }
  const tests::TemporaryFolder folder_;
  std::optional<RecordingReader> reader_;
  std::vector<RecordedMessage> handed_;
  std::stop_source stop_;
};

TEST_F(Player, HandsOverWhatIsChosenInOrderAndNeverEarly) {
  const auto begin = Pace::Clock::now();
  const auto played = run(2, [](const RecordedMessage& message) { return message.channel == 1; });
  EXPECT_GE(Pace::Clock::now() - begin, 90ms);  // from the second message to the last
  EXPECT_EQ(played.messages, 10u);
  ASSERT_EQ(handed_.size(), 10u);
  for (std::size_t i = 0; i < handed_.size(); ++i)
    EXPECT_EQ(handed_[i].message.payload.text(), std::to_string(2 * i + 1));
}

TEST_F(Player, EndsAtOnceWhenItIsStopped) {
  std::jthread stopper([this] { stop_.request_stop(); });
  EXPECT_LT(run(1e-6, [](const RecordedMessage&) { return true; }).messages, 20u);
}

TEST_F(Player, ReadsNoFurtherWhenItIsStoppedAlsoIfNothingIsChosen) {
  int looked_at = 0;
  const auto played = run(1, [&](const RecordedMessage&) {
    ++looked_at;
    stop_.request_stop();
    return false;
  });
  EXPECT_EQ(looked_at, 1);
  EXPECT_EQ(played.messages, 0u);
}

}  // namespace
}  // namespace iotcloud::recording
