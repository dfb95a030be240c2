// The driver with test pictures, files, V4L2 where the machine has a camera, and a private RTSP camera. What it
// publishes is decoded again.
#include <algorithm>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gst/gst.h>
#include <unistd.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/drivers/camera/camera_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::camera {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::MockHost;
using testing::MockInstance;
using ::testing::Not;

Descriptor camera_plugin() {
  return describe<CameraDriver>("camera", "test", true);
}

/// Runs a pipeline of GStreamer to its end. \return what went wrong
std::string run(const std::string& text) {
  gst_init(nullptr, nullptr);
  GError* error = nullptr;
  GstElement* pipeline = gst_parse_launch(text.c_str(), &error);
  std::string problem = error ? error->message : "";
  g_clear_error(&error);
  if (!problem.empty()) return problem;
  gst_element_set_state(pipeline, GST_STATE_PLAYING);
  GstBus* bus = gst_element_get_bus(pipeline);
  const auto limit = std::chrono::duration_cast<std::chrono::nanoseconds>(tests::patience).count();
  GstMessage* message = gst_bus_timed_pop_filtered(bus, static_cast<GstClockTime>(limit),
                                                   static_cast<GstMessageType>(GST_MESSAGE_ERROR | GST_MESSAGE_EOS));
  if (!message) {
    problem = "no end";
  } else if (GST_MESSAGE_TYPE(message) == GST_MESSAGE_ERROR) {
    gst_message_parse_error(message, &error, nullptr);
    problem = error->message;
    g_clear_error(&error);
  }
  if (message) gst_message_unref(message);
  gst_object_unref(bus);
  gst_element_set_state(pipeline, GST_STATE_NULL);
  gst_object_unref(pipeline);
  return problem;
}

/// The raw pictures in these bytes, as bytes of I420; empty when they cannot be decoded.
std::string decoded(const std::string& bytes, const std::string& decoder) {
  const tests::TemporaryFolder folder;
  const std::string in = folder / "in", out = folder / "out";
  tests::write_file(in, bytes);
  const std::string problem = run("filesrc location=" + in + " ! " + decoder +
                                  " ! videoconvert ! video/x-raw,format=I420 ! filesink location=" + out);
  EXPECT_EQ(problem, "");
  return tests::read_file(out);
}

std::size_t picture_bytes(int width, int height) {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3 / 2;
}

std::string property(const Message& message, std::string_view name) {
  const std::string* value = message.properties.find(name);
  return value ? *value : "";
}

void expect_jpeg(const Message& message, int width, int height) {
  EXPECT_EQ(property(message, "format"), "jpeg");
  EXPECT_EQ(property(message, "width"), std::to_string(width));
  EXPECT_EQ(property(message, "height"), std::to_string(height));
  EXPECT_EQ(property(message, "key"), "");
  EXPECT_EQ(decoded(std::string(message.payload.text()), "jpegdec").size(), picture_bytes(width, height));
}

std::string bytes_of(const std::vector<MockHost::Published>& frames) {
  std::string all;
  for (const auto& frame : frames) all += frame.message.payload.text();
  return all;
}

/// An instance that has sent so many frames.
std::unique_ptr<MockInstance> playing(PropertyMap properties, std::size_t frames) {
  auto instance = std::make_unique<MockInstance>(camera_plugin(), std::move(properties));
  EXPECT_TRUE(instance->start()) << instance->error();
  EXPECT_TRUE(until_published(*instance, "frames", frames)) << instance->host().metadata()["connection_problem"];
  return instance;
}

/// Runs in real time, with simulated time beside it, so that the driver looks for its camera again.
[[nodiscard]] bool until_again(MockInstance& instance, const std::function<bool()>& condition) {
  return until(instance, [&] {
    instance.host().advance(1ms);
    return condition();
  });
}

/// A video of so many pictures, 320x240 at 30 a second.
std::string video(const tests::TemporaryFolder& folder, int pictures) {
  const std::string file = folder / "video.mp4";
  EXPECT_EQ(run("videotestsrc pattern=ball num-buffers=" + std::to_string(pictures) +
                " ! video/x-raw,width=320,height=240,framerate=30/1 ! openh264enc gop-size=10 ! h264parse ! mp4mux ! "
                "filesink "
                "location=" +
                file),
            "");
  return file;
}

bool has_ended(MockInstance& instance) {
  return instance.host().metadata()["connection_problem"].starts_with("the file has been played to its end");
}

/// What stands before an RTSP camera in these tests.
PropertyMap watching(const tests::PrivateServer& camera, PropertyMap more = {}) {
  more.merge(PropertyMap{{"source", camera.url()}, {"reconnect_ms", "10"}, {"reconnect_most_ms", "100"}});
  return more;
}

std::string refusal(PropertyMap properties) {
  MockInstance instance(camera_plugin(), std::move(properties));
  EXPECT_FALSE(instance.open());
  return instance.error() + instance.host().failure();
}

TEST(Camera, sends_jpeg_frames_with_size_format_and_time) {
  const auto before = config::system_clock().wall_ms();
  const auto camera = playing({{"source", "test"}}, 3);
  const auto frames = camera->host().published("frames");
  for (const auto& frame : frames) expect_jpeg(frame.message, 640, 480);
  constexpr std::size_t of_marker = 6;
  EXPECT_EQ(frames[0].message.payload.text().substr(of_marker, 4), "JFIF") << "as all decoders take it";
  EXPECT_GE(frames[0].message.time_ms, before);
  EXPECT_LE(frames[0].message.time_ms, config::system_clock().wall_ms());
  EXPECT_GT(frames[1].message.time_ms, frames[0].message.time_ms);
  EXPECT_GT(std::stol(property(frames[1].message, "position_ms")),
            std::stol(property(frames[0].message, "position_ms")));
  EXPECT_NE(decoded(std::string(frames[0].message.payload.text()), "jpegdec"),
            decoded(std::string(frames[2].message.payload.text()), "jpegdec"))
      << "the ball does not move";
  const auto metadata = camera->host().metadata();
  EXPECT_EQ(metadata.at("connection"), "connected");
  EXPECT_EQ(metadata.at("camera"), "test");
  EXPECT_EQ(metadata.at("frames"), "jpeg 640x480");
}

TEST(Camera, has_one_channel_that_keeps_the_newest) {
  MockInstance camera(camera_plugin(), {{"source", "test"}, {"broker", "video"}});
  ASSERT_TRUE(camera.open()) << camera.error();
  ASSERT_EQ(camera.channels().size(), 1u);
  EXPECT_EQ(camera.channels()[0].name, "frames");
  EXPECT_EQ(camera.channels()[0].direction, Direction::out);
  EXPECT_EQ(camera.channels()[0].when_full, WhenFull::keep_newest);
  EXPECT_EQ(camera.channels()[0].broker, "video");
}

TEST(Camera, makes_pictures_smaller_in_their_proportions_and_never_larger) {
  expect_jpeg(playing({{"source", "test:smpte"}, {"width", "321"}}, 1)->host().published("frames")[0].message, 320,
              240);
  expect_jpeg(
      playing({{"source", "test"}, {"height", "120"}, {"width", "400"}}, 1)->host().published("frames")[0].message, 160,
      120);
  expect_jpeg(playing({{"source", "test"}, {"width", "4000"}}, 1)->host().published("frames")[0].message, 640, 480);
}

TEST(Camera, sends_jpeg_of_the_quality_that_is_asked_for) {
  const auto size = [](const char* quality) {
    return playing({{"source", "test:smpte"}, {"quality", quality}}, 1)
        ->host()
        .published("frames")[0]
        .message.payload.size();
  };
  EXPECT_LT(2 * size("20"), size("95"));
}

TEST(Camera, makes_h264_that_begins_with_a_key_frame) {
  const auto camera = playing({{"source", "test"}, {"format", "h264"}, {"width", "320"}}, 40);
  const auto frames = camera->host().published("frames");
  EXPECT_EQ(property(frames[0].message, "format"), "h264");
  EXPECT_EQ(property(frames[0].message, "width"), "320");
  EXPECT_EQ(property(frames[0].message, "key"), "true");
  EXPECT_EQ(property(frames[1].message, "key"), "false");
  EXPECT_EQ(decoded(bytes_of(frames), "h264parse ! openh264dec").size(), frames.size() * picture_bytes(320, 240));
  // A reader may begin at any key frame.
  const auto second = std::find_if(frames.begin() + 1, frames.end(),
                                   [](const auto& frame) { return property(frame.message, "key") == "true"; });
  ASSERT_NE(second, frames.end());
  EXPECT_EQ(decoded(bytes_of({second, frames.end()}), "h264parse ! openh264dec").size(),
            static_cast<std::size_t>(frames.end() - second) * picture_bytes(320, 240));
}

TEST(Camera, plays_a_file_once_at_the_rate_that_is_asked_for) {
  const tests::TemporaryFolder folder;
  const std::string file = video(folder, 30);
  const auto all = playing({{"source", "file:" + file}}, 30);
  ASSERT_TRUE(until(*all, [&] { return has_ended(*all); }));
  EXPECT_EQ(all->host().published("frames").size(), 30u);
  expect_jpeg(all->host().published("frames")[29].message, 320, 240);
  EXPECT_EQ(property(all->host().published("frames")[29].message, "position_ms"), "966");
  const auto few = playing({{"source", "file:" + file}, {"rate", "10"}}, 10);
  ASSERT_TRUE(until(*few, [&] { return has_ended(*few); }));
  std::vector<std::string> positions;
  for (const auto& frame : few->host().published("frames")) positions.push_back(property(frame.message, "position_ms"));
  EXPECT_THAT(positions, ::testing::ElementsAre("0", "100", "200", "300", "400", "500", "600", "700", "800", "900"));
}

TEST(Camera, plays_a_file_again_and_again) {
  const tests::TemporaryFolder folder;
  const auto camera = playing({{"source", "file:" + video(folder, 5)}, {"loop", "true"}, {"format", "h264"}}, 12);
  const auto frames = camera->host().published("frames");
  EXPECT_EQ(property(frames[0].message, "position_ms"), property(frames[5].message, "position_ms"));
  EXPECT_EQ(property(frames[5].message, "key"), "true");
  EXPECT_EQ(frames[5].message.payload, frames[0].message.payload) << "the bytes of the file are passed on";
  EXPECT_EQ(decoded(bytes_of(frames), "h264parse ! openh264dec").size(), frames.size() * picture_bytes(320, 240));
}

TEST(Camera, says_what_is_wrong_with_a_file_and_looks_for_it_again) {
  const tests::TemporaryFolder folder;
  const std::string file = folder / "video.mp4";
  MockInstance camera(camera_plugin(),
                      {{"source", "file:" + file}, {"reconnect_ms", "10"}, {"reconnect_most_ms", "10"}});
  ASSERT_TRUE(camera.start()) << camera.error();
  const auto problem = [&] { return camera.host().metadata()["connection_problem"]; };
  ASSERT_TRUE(until(camera, [&] { return problem().find("No such file") != std::string::npos; })) << problem();
  EXPECT_THAT(problem(), HasSubstr(file));
  tests::write_file(file, "this is no video");
  ASSERT_TRUE(until_again(camera, [&] { return problem().find("No such file") == std::string::npos; }));
  EXPECT_NE(camera.host().metadata()["connection"], "connected");
  video(folder, 5);
  ASSERT_TRUE(until_again(camera, [&] { return camera.host().published("frames").size() == 5; })) << problem();
}

TEST(Camera, reads_a_file_no_further_while_the_channel_is_full_and_loses_nothing) {
  const tests::TemporaryFolder folder;
  MockInstance camera(camera_plugin(),
                      {{"source", "file:" + video(folder, 30)}, {"channel.frames.when_full", "block"}});
  camera.host().answer_publish("frames", PublishStatus::would_block);
  ASSERT_TRUE(camera.start()) << camera.error();
  ASSERT_TRUE(until_metadata(camera, "connection", "connected"));
  for (std::size_t taken = 1; taken <= 30; ++taken) {
    camera.host().answer_publish("frames", PublishStatus::accepted);
    camera.host().on_publish([&](const auto&) { camera.host().answer_publish("frames", PublishStatus::would_block); });
    camera.writable("frames");
    ASSERT_TRUE(until_published(camera, "frames", taken));
    EXPECT_EQ(camera.host().published("frames").size(), taken);
    camera.host().on_publish(nullptr);
  }
  camera.host().answer_publish("frames", PublishStatus::accepted);
  camera.writable("frames");
  ASSERT_TRUE(until(camera, [&] { return has_ended(camera); }));
  EXPECT_EQ(camera.host().published("frames").size(), 30u);
  EXPECT_EQ(camera.host().logged_count("left out"), 0u);
}

TEST(Camera, keeps_the_newest_frame_of_a_camera_while_the_channel_is_full) {
  MockInstance camera(camera_plugin(), {{"source", "test"}});
  camera.host().answer_publish("frames", PublishStatus::would_block);
  ASSERT_TRUE(camera.start()) << camera.error();
  ASSERT_TRUE(until(camera, [&] { return camera.host().logged_count("a frame is left out") > 0; }));
  camera.host().answer_publish("frames", PublishStatus::accepted);
  camera.writable("frames");
  ASSERT_TRUE(until_published(camera, "frames", 2));
  EXPECT_NE(property(camera.host().published("frames")[0].message, "position_ms"), "0");
}

TEST(Camera, goes_on_with_a_key_frame_after_frames_of_h264_were_left_out) {
  MockInstance camera(camera_plugin(), {{"source", "test"}, {"format", "h264"}, {"width", "160"}});
  ASSERT_TRUE(camera.start()) << camera.error();
  ASSERT_TRUE(until_published(camera, "frames", 2));
  camera.host().answer_publish("frames", PublishStatus::would_block);
  ASSERT_TRUE(until(camera, [&] { return camera.host().logged_count("a frame is left out") > 0; }));
  camera.host().forget_published();
  camera.host().answer_publish("frames", PublishStatus::accepted);
  camera.writable("frames");
  ASSERT_TRUE(until_published(camera, "frames", 5));
  const auto frames = camera.host().published("frames");
  EXPECT_EQ(property(frames[0].message, "key"), "true");
  EXPECT_EQ(decoded(bytes_of(frames), "h264parse ! openh264dec").size(), frames.size() * picture_bytes(160, 120));
}

TEST(Camera, leaves_out_frames_that_are_too_long) {
  MockInstance camera(camera_plugin(), {{"source", "test:snow"}, {"most_bytes", "1000"}});
  ASSERT_TRUE(camera.start()) << camera.error();
  ASSERT_TRUE(until(camera, [&] { return camera.host().logged_count("is longer than most_bytes") > 0; }));
  EXPECT_THAT(camera.host().published("frames"), IsEmpty());
  EXPECT_EQ(camera.host().metadata()["connection"], "connected");
}

TEST(Camera, is_closed_while_the_instance_is_stopped) {
  const auto camera = playing({{"source", "test"}}, 1);
  ASSERT_TRUE(camera->deactivate());
  EXPECT_THAT(camera->host().metadata()["connection_problem"], HasSubstr("while the instance is stopped"));
  camera->host().run_posted();
  camera->host().forget_published();
  camera->host().advance(60s);
  EXPECT_EQ(camera->host().poll_descriptors(0ms), 0u);
  EXPECT_THAT(camera->host().published("frames"), IsEmpty());
  ASSERT_TRUE(camera->activate());
  EXPECT_TRUE(until_published(*camera, "frames", 1));
  camera->close();
  EXPECT_EQ(camera->error(), "");
}

TEST(Camera, passes_on_h264_of_an_rtsp_camera) {
  const tests::PrivateServer server("rtsp_camera.py");
  const auto camera = playing(watching(server, {{"format", "h264"}}), 40);
  const auto frames = camera->host().published("frames");
  EXPECT_EQ(property(frames[0].message, "key"), "true");
  EXPECT_EQ(property(frames[0].message, "width"), "320");
  EXPECT_EQ(decoded(bytes_of(frames), "h264parse ! openh264dec").size(), frames.size() * picture_bytes(320, 240));
  EXPECT_EQ(camera->host().metadata()["frames"], "h264 320x240");
}

TEST(Camera, makes_fewer_and_smaller_jpeg_frames_of_h264) {
  const tests::PrivateServer server("rtsp_camera.py");
  const auto camera = playing(watching(server, {{"width", "160"}, {"rate", "10"}}), 5);
  const auto frames = camera->host().published("frames");
  expect_jpeg(frames[0].message, 160, 120);
  const auto position = [&](std::size_t i) { return std::stol(property(frames[i].message, "position_ms")); };
  EXPECT_GE(position(4) - position(0), 350);
}

TEST(Camera, passes_on_jpeg_of_an_rtsp_camera_that_wants_a_password) {
  const tests::PrivateServer server("rtsp_camera.py", {"--format", "jpeg", "--user"});
  const tests::TemporaryFolder folder;
  const std::string wrong = tests::write_file(folder / "wrong", "wrong\n");
  MockInstance refused(camera_plugin(), watching(server, {{"user", tests::server_user}, {"password_file", wrong}}));
  ASSERT_TRUE(refused.start()) << refused.error();
  const auto problem = [&] { return refused.host().metadata()["connection_problem"]; };
  ASSERT_TRUE(until(refused, [&] { return problem().find("Unauthorized") != std::string::npos; })) << problem();
  EXPECT_THAT(problem(), Not(HasSubstr("wrong")));
  refused.close();
  const std::string right = tests::write_file(folder / "right", std::string(tests::server_password) + "\n");
  const auto camera = playing(watching(server, {{"user", tests::server_user}, {"password_file", right}}), 3);
  for (const auto& frame : camera->host().published("frames")) expect_jpeg(frame.message, 320, 240);
}

TEST(Camera, comes_back_to_an_rtsp_camera_that_vanished_and_returned) {
  tests::PrivateServer server("rtsp_camera.py");
  const auto camera = playing(watching(server, {{"format", "h264"}}), 3);
  server.kill();
  ASSERT_TRUE(until_metadata(*camera, "connection", "away"));
  ASSERT_TRUE(until_again(*camera, [&] {
    return camera->host().metadata()["connection_problem"].find("Failed to connect") != std::string::npos;
  })) << camera->host().metadata()["connection_problem"];
  server.start();
  camera->host().forget_published();
  ASSERT_TRUE(until_again(*camera, [&] { return camera->host().published("frames").size() >= 20; }))
      << camera->host().metadata()["connection_problem"];
  EXPECT_EQ(camera->host().metadata()["connection"], "connected");
  const auto frames = camera->host().published("frames");
  EXPECT_EQ(property(frames[0].message, "key"), "true");
  EXPECT_EQ(decoded(bytes_of(frames), "h264parse ! openh264dec").size(), frames.size() * picture_bytes(320, 240));
}

TEST(Camera, opens_a_camera_that_is_silent_anew) {
  tests::PrivateServer server("rtsp_camera.py", {"--format", "jpeg"});
  const auto camera = playing(watching(server, {{"silence_ms", "1000"}}), 3);
  server.pause();
  ASSERT_TRUE(until_again(*camera, [&] {
    return camera->host().metadata()["connection_problem"].find("no frame has come for silence_ms") !=
           std::string::npos;
  }));
  server.resume();
  camera->host().forget_published();
  // Simulated time goes on slowly, so that the camera has time to answer.
  ASSERT_TRUE(until(*camera, [&] {
    if (camera->host().metadata()["connection"] != "connected") camera->host().advance(1ms);
    return camera->host().published("frames").size() >= 3;
  })) << camera->host().metadata()["connection_problem"];
}

TEST(Camera, reads_a_camera_of_this_machine) {
  MockInstance missing(camera_plugin(), {{"source", "v4l2:/dev/no-such-video"}});
  ASSERT_TRUE(missing.start()) << missing.error();
  ASSERT_TRUE(until(missing, [&] {
    return missing.host().metadata()["connection_problem"].find("/dev/no-such-video") != std::string::npos;
  }));
  EXPECT_FALSE(missing.host().failed());
  missing.close();
  if (access("/dev/video0", R_OK | W_OK) != 0) GTEST_SKIP() << "this machine has no camera (/dev/video0)";
  const auto camera = playing({{"source", "v4l2:/dev/video0"}, {"width", "320"}}, 3);
  const auto frames = camera->host().published("frames");
  expect_jpeg(frames[0].message, 320, std::stoi(property(frames[0].message, "height")));
}

TEST(Camera, refuses_properties_that_make_no_sense) {
  EXPECT_THAT(refusal({}), HasSubstr("source"));
  EXPECT_THAT(refusal({{"source", "http://camera"}}), AllOf(HasSubstr("\"source\""), HasSubstr("rtsp://HOST")));
  EXPECT_THAT(refusal({{"source", "rtsp:///x"}}), HasSubstr("names no host"));
  EXPECT_THAT(refusal({{"source", "rtsp://me:secret@camera/x"}}),
              AllOf(HasSubstr("password_file"), Not(HasSubstr("secret"))));
  EXPECT_THAT(refusal({{"source", "v4l2:video0"}}), HasSubstr("v4l2:/dev/video0"));
  EXPECT_THAT(refusal({{"source", "file:video.mp4"}}), HasSubstr("path from the root"));
  EXPECT_THAT(refusal({{"source", "test:cat"}}), AllOf(HasSubstr("test:cat"), HasSubstr("ball, smpte")));
  EXPECT_THAT(refusal({{"source", "test"}, {"format", "png"}}), AllOf(HasSubstr("format"), HasSubstr("jpeg, h264")));
  for (const char* rate : {"-1", "0.0001", "1e-300"})
    EXPECT_THAT(refusal({{"source", "test"}, {"rate", rate}}), HasSubstr("rate"));
  EXPECT_THAT(refusal({{"source", "test"}, {"width", "1"}}), AllOf(HasSubstr("width"), HasSubstr("2 pixels")));
  EXPECT_THAT(refusal({{"source", "test"}, {"quality", "101"}}), HasSubstr("quality"));
  EXPECT_THAT(refusal({{"source", "test"}, {"loop", "true"}}), AllOf(HasSubstr("loop"), HasSubstr("a file")));
  EXPECT_THAT(refusal({{"source", "test"}, {"transport", "udp"}}), AllOf(HasSubstr("transport"), HasSubstr("RTSP")));
  EXPECT_THAT(refusal({{"source", "test"}, {"user", "me"}}), HasSubstr("user"));
  EXPECT_THAT(refusal({{"source", "rtsp://camera"}, {"user", "me"}}), HasSubstr("password_file"));
  EXPECT_THAT(refusal({{"source", "rtsp://camera"}, {"user", "me"}, {"password_file", "/no/such"}}),
              HasSubstr("/no/such"));
  EXPECT_THAT(refusal({{"source", "test"}, {"with", "320"}}), HasSubstr("with"));
}

}  // namespace
}  // namespace iotcloud::drivers::camera
