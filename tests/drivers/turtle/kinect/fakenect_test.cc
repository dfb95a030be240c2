#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/recording/recording.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/scratch_folder.h>

// libfreenect's replay replaces libfreenect: this program's run path leads to it. The replay keeps its place in the
// recording for the life of the process, so there is one test.
namespace iotcloud::drivers::turtle::kinect {
namespace {

using namespace std::chrono_literals;
using testing::MockInstance;

TEST(Fakenect, sends_what_was_recorded_and_at_its_end_the_camera_counts_as_gone) {
  constexpr int frames = 6;
  ScratchFolder folder("fakenect");
  {
    recording::RecordingWriter writer(folder.path());
    for (int i = 0; i < frames; ++i) {
      const std::vector<std::uint16_t> disparities(depth::frame_pixels, static_cast<std::uint16_t>(600 + 20 * i));
      writer.add(depth::FrameView(disparities), 0.04 * i);
    }
  }
  setenv("FAKENECT_PATH", folder.path().c_str(), 1);
  MockInstance robot(describe<TurtleDriver>("turtle", "test", true),
                     {{"source", "kinect"}, {"reconnect_ms", "1"}, {"tilt", "5"}, {"led", "green"}});
  ASSERT_TRUE(robot.start()) << robot.error();
  const auto deadline = std::chrono::steady_clock::now() + 60s;
  // "absent" is reported after the last frame was posted.
  const auto ended = [&] {
    const auto metadata = robot.host().metadata();
    return metadata.contains("camera") && metadata.at("camera") == "absent";
  };
  while (!ended() && std::chrono::steady_clock::now() < deadline) {
    robot.host().run_posted();
    std::this_thread::yield();
  }
  robot.host().run_posted();
  EXPECT_EQ(robot.host().logged_count("the Kinect is gone"), 1);
  // When this thread was delayed, newer frames have overwritten older ones. The frames that came are in order, and the
  // last one is among them.
  const auto sent = robot.host().published("kinect");
  ASSERT_FALSE(sent.empty());
  depth::DepthDecoder decoder;
  std::vector<std::uint16_t> mm(depth::frame_pixels);
  int before = 0;
  for (const auto& frame : sent) {
    ASSERT_EQ(decoder.decode(frame.message.payload.bytes(), depth::FrameSpan(mm)), depth::DecodeError::none);
    EXPECT_GT(mm[0], before);
    before = mm[0];
  }
  EXPECT_EQ(before, depth::mm_table()[depth::code_table()[600 + 20 * (frames - 1)]]);
  robot.close();
  EXPECT_EQ(robot.host().logged_count("kinect: 6 frames"), 1);
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::kinect
