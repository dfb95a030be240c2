#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/recording/recording.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/scratch_folder.h>

namespace iotcloud::drivers::turtle::recording {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::MockInstance;

using Frame = std::vector<std::uint16_t>;

Frame frame_of(std::uint16_t disparity) {
  return Frame(depth::frame_pixels, disparity);
}

/// Frames of 500, 501, ... at these seconds.
void record(const ScratchFolder& folder, const std::vector<double>& seconds) {
  RecordingWriter writer(folder.path());
  for (std::size_t i = 0; i < seconds.size(); ++i) {
    writer.add(depth::FrameView(frame_of(static_cast<std::uint16_t>(500 + i))), seconds[i]);
  }
}

std::string failure_of(auto&& call) {
  try {
    call();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "";
}

TEST(Recording, reads_what_was_written) {
  ScratchFolder folder("written");
  record(folder, {0, 0.1, 0.25});
  const Recording recording(folder.path());
  ASSERT_EQ(recording.frames().size(), 3);
  EXPECT_EQ(recording.frames()[0].file, "d-1.000000-0.pgm");
  EXPECT_EQ(recording.frames()[1].stamp, 6'000'000);
  EXPECT_EQ(recording.interval_after(0), 100ms);
  EXPECT_EQ(recording.interval_after(1), 150ms);
  EXPECT_EQ(recording.interval_after(2), 150ms);  // back to the first
  Frame read(depth::frame_pixels);
  for (std::size_t i = 0; i < 3; ++i) {
    recording.read(i, depth::FrameSpan(read));
    EXPECT_EQ(read, frame_of(static_cast<std::uint16_t>(500 + i)));
  }
  EXPECT_EQ(std::filesystem::file_size(folder.path() / "d-1.000000-0.pgm"), 614'417);
}

TEST(Recording, is_whole_after_each_frame) {
  ScratchFolder folder("whole");
  RecordingWriter writer(folder.path());
  writer.add(depth::FrameView(frame_of(1)), 0);
  EXPECT_EQ(Recording(folder.path()).frames().size(), 1);
  writer.add(depth::FrameView(frame_of(2)), 1);
  EXPECT_EQ(Recording(folder.path()).frames().size(), 2);
}

TEST(Recording, is_not_written_over_another) {
  ScratchFolder folder("another");
  { RecordingWriter empty(folder.path()); }
  record(folder, {0});  // one without frames is none
  EXPECT_THAT(failure_of([&] { RecordingWriter again(folder.path()); }), HasSubstr("already"));
  EXPECT_THAT(failure_of([&] { RecordingWriter bad(folder.path() / "INDEX.txt" / "x"); }), HasSubstr("cannot make"));
}

TEST(Recording, passes_over_other_sensors_and_goes_round_where_time_goes_back) {
  ScratchFolder folder("rounds");
  folder.write("INDEX.txt", "r-1.0-5.ppm\na-1.1-6.dump\nd-5.0-7.pgm\nd-5.5-8.pgm\r\n\nd-5.0-7.pgm\nd-5.5-8.pgm");
  const Recording recording(folder.path());
  ASSERT_EQ(recording.frames().size(), 4);
  EXPECT_EQ(recording.interval_after(0), 500ms);
  EXPECT_EQ(recording.interval_after(1), 500ms);  // not -500
  EXPECT_EQ(recording.interval_after(2), 500ms);
}

TEST(Recording, has_intervals_also_between_times_that_nobody_recorded) {
  ScratchFolder folder("times");
  folder.write("INDEX.txt", "d-0-1.pgm\nd-1e-9-2.pgm\nd-1e12-3.pgm\n");
  const Recording recording(folder.path());
  EXPECT_GT(recording.interval_after(0), 0us) << "less than a microsecond";
  EXPECT_EQ(recording.interval_after(1), 1'000'000'000'000s);
  folder.write("INDEX.txt", "d-0-1.pgm\nd-1e300-2.pgm\n");
  EXPECT_THAT(failure_of([&] { Recording far(folder.path()); }), HasSubstr("is no frame's name"));
}

TEST(Recording, that_is_damaged_says_where) {
  EXPECT_THAT(failure_of([] { Recording("/nonexistent"); }), AllOf(HasSubstr("/nonexistent"), HasSubstr("INDEX.txt")));
  ScratchFolder folder("damaged");
  for (const std::string name : {"d-1.0-5.png", "../d-1.0-5.pgm", "d-x-5.pgm", "d-1.0-99999999999.pgm", "d-nan-5.pgm",
                                 "d-1.0-5/../x.pgm", "frame1.pgm"}) {
    folder.write("INDEX.txt", "d-1.0-5.pgm\n" + name + "\n");
    EXPECT_THAT(failure_of([&] { Recording(folder.path()); }), AllOf(HasSubstr("INDEX.txt:2"), HasSubstr(name)))
        << name;
  }
  folder.write("INDEX.txt", "r-1.0-5.ppm\n");
  EXPECT_THAT(failure_of([&] { Recording(folder.path()); }), HasSubstr("no depth"));

  folder.write("INDEX.txt", "d-1.0-5.pgm\n");
  const Recording recording(folder.path());
  Frame read(depth::frame_pixels);
  const auto error = [&] { return failure_of([&] { recording.read(0, depth::FrameSpan(read)); }); };
  EXPECT_THAT(error(), HasSubstr("d-1.0-5.pgm"));
  folder.write("d-1.0-5.pgm", "P5 320 240 65535\n" + std::string(614'400, 'x'));
  EXPECT_THAT(error(), HasSubstr("P5 640 480 65535"));
  folder.write("d-1.0-5.pgm", "P5 640 480 65535\n" + std::string(614'399, 'x'));
  EXPECT_THAT(error(), HasSubstr("614399 of 614400"));
}

/// What a turtle that plays this recording sends in so long: the payloads' first pixels, in millimetres.
std::vector<int> played(const ScratchFolder& folder, PropertyMap properties, std::chrono::microseconds time) {
  properties["source"] = "recording";
  properties["path"] = folder.path();
  MockInstance robot(describe<TurtleDriver>("turtle", "test", true), properties);
  EXPECT_TRUE(robot.start()) << robot.error();
  robot.host().advance(time);
  EXPECT_FALSE(robot.host().failed()) << robot.host().failure();
  std::vector<int> mm;
  depth::DepthDecoder decoder;
  Frame decoded(depth::frame_pixels);
  for (const auto& sent : robot.host().published("kinect")) {
    EXPECT_EQ(decoder.decode(sent.message.payload.bytes(), depth::FrameSpan(decoded)), depth::DecodeError::none);
    mm.push_back(decoded[0]);
  }
  return mm;
}

int coded(int disparity) {
  return depth::mm_table()[depth::code_table()[static_cast<std::size_t>(disparity)]];
}

TEST(RecordedSource, plays_at_the_recording_s_pace_round_and_round) {
  ScratchFolder folder("played");
  record(folder, {0, 0.1, 0.4});
  const int a = coded(500), b = coded(501), c = coded(502);
  EXPECT_EQ(played(folder, {}, 399ms), (std::vector{a, b}));
  EXPECT_EQ(played(folder, {}, 401ms), (std::vector{a, b, c}));
  EXPECT_EQ(played(folder, {}, 1101ms), (std::vector{a, b, c, a, b, c}));  // the last interval also leads back
  EXPECT_EQ(played(folder, {{"loop", "false"}}, 10s), (std::vector{a, b, c}));
  EXPECT_EQ(played(folder, {{"speed", "10"}, {"rate", "120"}}, 41ms), (std::vector{a, b, c}));
  EXPECT_EQ(played(folder, {{"rate", "2"}}, 1099ms), (std::vector{a, a}));  // at most
}

TEST(RecordedSource, needs_a_recording_and_fails_with_a_file_that_is_gone) {
  const Descriptor turtle = describe<TurtleDriver>("turtle", "test", true);
  MockInstance without(turtle, {{"source", "recording"}});
  EXPECT_FALSE(without.open());
  EXPECT_THAT(without.error(), HasSubstr("\"path\""));
  MockInstance nowhere(turtle, {{"source", "recording"}, {"path", "/nonexistent"}});
  EXPECT_FALSE(nowhere.open());
  EXPECT_THAT(nowhere.error(), HasSubstr("/nonexistent"));

  ScratchFolder folder("gone");
  record(folder, {0, 0.1});
  std::filesystem::remove(folder.path() / "d-1.100000-6000000.pgm");
  MockInstance robot(turtle, {{"source", "recording"}, {"path", folder.path()}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(50ms);
  EXPECT_FALSE(robot.host().failed());
  robot.host().advance(100ms);
  EXPECT_THAT(robot.host().failure(), HasSubstr("d-1.100000-6000000.pgm"));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::recording
