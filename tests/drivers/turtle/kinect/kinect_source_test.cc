#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/kinect/kinect_source.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/kinect/stub_freenect.h>

namespace iotcloud::drivers::turtle::kinect {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;
using testing::MockHost;
using testing::MockInstance;

/// A source whose event thread is the test's.
class KinectSourceTest : public ::testing::Test {
 protected:
  KinectSourceTest() { stub::reset(); }
  ~KinectSourceTest() override { source_.reset(); }

  KinectSource& start(KinectOptions options = {}) {
    options.reconnect = 1ms;
    source_ = std::make_unique<KinectSource>(options, context_);
    source_->start([this](const DepthFrame& frame) {
      values_.push_back((*frame.disparities)[0]);
      EXPECT_EQ((*frame.disparities)[depth::frame_pixels - 1], values_.back());  // a whole frame, of one number
      times_.push_back(frame.device_time_s);
    });
    return *source_;
  }
  /// Runs posted callbacks until this holds, for at most a minute.
  template <typename Condition>
  bool run_until(Condition holds) {
    const auto deadline = std::chrono::steady_clock::now() + 60s;
    while (!holds()) {
      if (std::chrono::steady_clock::now() > deadline) return false;
      host_.run_posted();
      std::this_thread::yield();
    }
    return true;
  }

  MockHost host_;
  DriverContext context_{host_};
  std::unique_ptr<KinectSource> source_;
  std::vector<unsigned> values_;
  std::vector<double> times_;
};

TEST_F(KinectSourceTest, hands_over_frames_with_the_device_s_time) {
  stub::plug_in({{"A001"}});
  start();
  ASSERT_TRUE(run_until([&] { return values_.size() >= 3; }));
  source_->stop();
  EXPECT_NEAR(times_[2] - times_[0], 2.0 * (values_[2] - values_[0]), 1e-6);  // also past where the stamp wraps round
  EXPECT_EQ(host_.metadata().at("camera"), "connected");
  EXPECT_FALSE(stub::seen().motor_selected);  // no caller asked for it
  EXPECT_EQ(stub::seen().devices, 0);
  EXPECT_EQ(stub::seen().contexts, 0);
}

TEST_F(KinectSourceTest, keeps_the_newest_frame_only_while_the_event_thread_is_busy) {
  stub::plug_in({{"A001"}});
  KinectSource& source = start();
  const auto deadline = std::chrono::steady_clock::now() + 60s;
  while (source.counts().superseded < 20 && std::chrono::steady_clock::now() < deadline) std::this_thread::yield();
  stub::hold(true);
  host_.run_posted();
  ASSERT_EQ(values_.size(), 1);  // all those frames, and one callback
  EXPECT_GT(values_[0], 20);
  stub::hold(false);
  EXPECT_TRUE(run_until([&] { return values_.size() >= 3; }));
}

TEST_F(KinectSourceTest, leaves_frames_out_that_come_faster_than_its_rate) {
  stub::plug_in({{"A001"}});
  KinectOptions options;
  options.period = 1h;
  KinectSource& source = start(options);
  // The first two: what comes late may be followed at once.
  ASSERT_TRUE(run_until([&] { return source.counts().frames >= 10 && !values_.empty(); }));
  source.stop();
  EXPECT_LE(values_.size(), 2);
}

TEST_F(KinectSourceTest, opens_a_device_by_index_or_by_serial_number) {
  stub::plug_in({{"A001"}, {"B0022"}, {"C1234567"}});
  KinectOptions options;
  options.camera.device = "1";
  start(options);
  ASSERT_TRUE(run_until([&] { return !values_.empty(); }));
  EXPECT_EQ(stub::seen().opened, "B0022");
  source_->stop();
  values_.clear();
  options.camera.device = "C1234567";
  start(options);
  ASSERT_TRUE(run_until([&] { return !values_.empty(); }));
  EXPECT_EQ(stub::seen().opened, "C1234567");
}

TEST_F(KinectSourceTest, lists_what_is_there_when_the_device_is_not_and_says_so_once) {
  stub::plug_in({{"A001"}, {"B0022"}});
  KinectOptions options;
  options.camera.device = "C1234567";
  KinectSource& source = start(options);
  ASSERT_TRUE(run_until([&] { return source.counts().failed >= 3; }));
  EXPECT_EQ(host_.logged_count("C1234567"), 1);
  EXPECT_EQ(host_.logged_count("0 with serial number A001, 1 with serial number B0022"), 1);
  EXPECT_EQ(host_.metadata().at("camera"), "absent");
  stub::plug_in({{"A001"}, {"C1234567"}});
  EXPECT_TRUE(run_until([&] { return !values_.empty(); }));
}

TEST_F(KinectSourceTest, says_what_keeps_it_from_opening_one) {
  stub::plug_in({{"A001", false}});
  KinectSource& source = start();
  ASSERT_TRUE(run_until([&] { return source.counts().failed >= 1; }));
  EXPECT_EQ(host_.logged_count("Could not claim interface"), 1);
  source.stop();
  stub::plug_in({});
  KinectSource& none = start();
  ASSERT_TRUE(run_until([&] { return none.counts().failed >= 1; }));
  EXPECT_EQ(host_.logged_count("no Kinect on this machine"), 1);
}

TEST_F(KinectSourceTest, finds_a_device_again_that_was_unplugged) {
  stub::plug_in({{"A001"}});
  KinectSource& source = start();
  for (int round = 1; round <= 3; ++round) {
    ASSERT_TRUE(run_until([&] { return source.counts().connects == static_cast<std::uint64_t>(round); }));
    host_.run_posted();  // a frame of the last time may have waited
    values_.clear();
    ASSERT_TRUE(run_until([&] { return !values_.empty(); }));
    const std::uint64_t failed = source.counts().failed;
    stub::plug_in({});
    ASSERT_TRUE(run_until([&] { return source.counts().failed >= failed + 2; }));
    EXPECT_EQ(host_.metadata().at("camera"), "absent");
    EXPECT_EQ(host_.logged_count("the Kinect is gone"), static_cast<std::size_t>(round));  // once each time
    EXPECT_EQ(source.counts().lost, static_cast<std::uint64_t>(round));
    stub::plug_in({{"A001"}});
  }
  EXPECT_EQ(host_.logged_count("no Kinect on this machine"), 0);  // it was said that it is gone
}

TEST_F(KinectSourceTest, opens_a_device_again_that_fell_silent) {
  stub::plug_in({{"A001"}});
  KinectOptions options;
  options.silence = 5ms;
  KinectSource& source = start(options);
  ASSERT_TRUE(run_until([&] { return !values_.empty(); }));
  stub::hold(true);
  ASSERT_TRUE(run_until([&] { return source.counts().lost >= 1; }));
  EXPECT_GE(host_.logged_count("no frame came from the Kinect"), 1);  // a slow machine may be silent earlier, too
  stub::hold(false);
  values_.clear();
  EXPECT_TRUE(run_until([&] { return !values_.empty(); }));
}

TEST_F(KinectSourceTest, sets_tilt_and_light_and_goes_on_without_a_motor) {
  stub::plug_in({{"A001"}});
  KinectOptions options;
  options.camera.tilt = -12.5;
  options.camera.led = "blink_red_yellow";
  start(options);
  ASSERT_TRUE(run_until([&] { return !values_.empty(); }));
  EXPECT_EQ(stub::seen().tilt, -12.5);
  EXPECT_EQ(stub::seen().led, 6);
  EXPECT_TRUE(stub::seen().motor_selected);
  source_->stop();
  stub::plug_in({{"A001", true, false}});
  values_.clear();
  start(options);
  EXPECT_TRUE(run_until([&] { return !values_.empty(); }));
  EXPECT_EQ(host_.logged_count("tilt cannot be set"), 1);
  EXPECT_EQ(host_.logged_count("light cannot be set"), 1);
}

TEST_F(KinectSourceTest, may_be_stopped_from_inside_a_frame_and_started_again) {
  stub::plug_in({{"A001"}});
  KinectOptions options;
  options.reconnect = 1ms;
  KinectSource source(options, context_);
  int frames = 0;
  const auto stop_at_once = [&](const DepthFrame&) {
    ++frames;
    source.stop();
  };
  source.start(stop_at_once);
  ASSERT_TRUE(run_until([&] { return frames == 1; }));
  EXPECT_EQ(stub::seen().devices, 0);
  source.start(stop_at_once);
  ASSERT_TRUE(run_until([&] { return frames == 2; }));
  host_.run_posted();
  EXPECT_EQ(frames, 2);
}

TEST(KinectKind, is_a_turtle_s_source) {
  stub::reset();
  stub::plug_in({{"A001"}});
  const Descriptor turtle = describe<TurtleDriver>("turtle", "test", true);
  const auto error_with = [&](const PropertyMap& properties) {
    PropertyMap all = properties;
    all["source"] = "kinect";
    MockInstance robot(turtle, all);
    EXPECT_FALSE(robot.open());
    return robot.error();
  };
  EXPECT_THAT(error_with({{"tilt", "45"}}), HasSubstr("-30"));
  EXPECT_THAT(error_with({{"led", "purple"}}), HasSubstr("blink_green"));
  EXPECT_THAT(error_with({{"seed", "1"}}), HasSubstr("silence_ms"));
  MockInstance robot(turtle, {{"source", "kinect"}, {"device", "A001"}, {"tilt", "3"}, {"rate", "120"}});
  ASSERT_TRUE(robot.start()) << robot.error();
  const auto deadline = std::chrono::steady_clock::now() + 60s;
  while (robot.host().published("kinect").empty() && std::chrono::steady_clock::now() < deadline) {
    robot.host().advance(1ms);
  }
  ASSERT_FALSE(robot.host().published("kinect").empty());
  robot.close();
  EXPECT_EQ(robot.host().logged_count(" connections"), 1);
  EXPECT_EQ(stub::seen().contexts, 0);
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::kinect
