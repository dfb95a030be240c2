// The simulated world stands still until its frame is answered: a closed loop without time.
#include <chrono>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/drivers/turtle/turtle_fixture.h>

namespace iotcloud::drivers::turtle {
namespace {

using namespace std::chrono_literals;
using testing::MockInstance;

TEST(TurtleDriverInLockStep, waits_for_the_answer_and_sends_the_frame_again_when_none_comes) {
  MockInstance robot(turtle, {{"clock", "lockstep"}, {"retry_ms", "500"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(1100ms);
  auto frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 3);  // one frame, sent three times
  for (const auto& frame : frames) {
    EXPECT_EQ(*frame.message.properties.find("seq"), "0");
    EXPECT_EQ(frame.message.time_ms, frames[0].message.time_ms);
    EXPECT_EQ(frame.message.payload.text(), frames[0].message.payload.text());
  }
  ASSERT_TRUE(robot.deliver("control", command(Velocity{}, frames[0].message.time_ms)));
  ASSERT_TRUE(
      robot.deliver("control", command(Velocity{}, frames[0].message.time_ms)));  // the answer to the repetition
  frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 4);
  EXPECT_EQ(*frames[3].message.properties.find("seq"), "1");
}

/// Runs a whole robot in lock step with the reference follower, through the driver's interface.
std::vector<std::map<std::string, std::string>> follow_in_lock_step(const std::string& seed, const std::string& name,
                                                                    int frames, int& lost) {
  ScratchFile trace(name);
  MockInstance robot(
      turtle, {{"clock", "lockstep"}, {"seed", seed}, {"frames", std::to_string(frames)}, {"trace", trace.path()}});
  std::size_t answered = 0;
  EXPECT_TRUE(robot.start());
  robot.host().run_posted();
  for (;;) {
    const auto published = robot.host().published("kinect");
    if (published.empty()) break;
    EXPECT_EQ(published.size(), 1);
    robot.host().forget_published();
    const Message& frame = published.front().message;
    const Followed followed = follow(depth::FrameView(decoded(frame)));
    if (followed.lost()) ++lost;
    ++answered;
    EXPECT_TRUE(robot.deliver("control", command(followed.command, frame.time_ms)));
  }
  EXPECT_EQ(answered, static_cast<std::size_t>(frames));
  robot.close();
  return trace.rows();
}

TEST(TurtleDriverInLockStep, closes_the_loop_and_keeps_its_distance) {
  int lost = 0;
  const auto rows = follow_in_lock_step("3", "loop.csv", 450, lost);
  ASSERT_EQ(rows.size(), 450);
  EXPECT_EQ(lost, 0);
  double error = 0;
  for (const auto& row : rows) {
    EXPECT_EQ(row.at("answered"), "1");
    EXPECT_EQ(row.at("visible"), "1");
    EXPECT_EQ(row.at("in_box"), "1");
    error += std::abs(number(row, "error"));
    EXPECT_NEAR(number(row, "distance") - 0.7, number(row, "error"), 0.0002);
  }
  EXPECT_LT(error / 450, 0.25);
  EXPECT_NEAR(number(rows.back(), "device_s"), 449 / 30.0, 0.001);
  const double walked = std::hypot(number(rows.back(), "person_x") - number(rows.front(), "person_x"),
                                   number(rows.back(), "person_y") - number(rows.front(), "person_y"));
  EXPECT_GT(walked, 0.5);  // else the test proves nothing
  EXPECT_NEAR(number(rows.back(), "monotonic_us") - number(rows.front(), "monotonic_us"),
              1e6 * (number(rows.back(), "capture_s") - number(rows.front(), "capture_s")), 2);
}

TEST(TurtleDriverInLockStep, repeats_a_run_to_the_last_digit) {
  const auto world = [](std::vector<std::map<std::string, std::string>> rows) {
    for (auto& row : rows) {
      for (const char* column : {"time_ms", "capture_s", "render_us", "encode_us", "latency_us", "monotonic_us"})
        row.erase(column);
    }
    return rows;
  };
  int lost = 0;
  EXPECT_EQ(world(follow_in_lock_step("9", "once.csv", 90, lost)),
            world(follow_in_lock_step("9", "again.csv", 90, lost)));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle
