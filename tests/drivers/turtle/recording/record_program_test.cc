#include <csignal>
#include <cstdio>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <sys/wait.h>

#include <iotcloud/drivers/turtle/recording/recording.h>
#include <iotcloud/tests/drivers/turtle/scratch_folder.h>

namespace iotcloud::drivers::turtle::recording {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

struct Ended {
  int status = 0;
  std::string said;  ///< on both outputs
};

/// iotcloud-record with these words. \param until a text on which it gets SIGINT.
Ended run(const std::string& words, const std::string& until = "") {
  const std::string command = "echo $$; exec " IOTCLOUD_RECORD " " + words + " 2>&1";
  std::FILE* output = popen(command.c_str(), "r");
  Ended ended;
  char line[512];
  const pid_t process = std::fgets(line, sizeof line, output) ? std::atoi(line) : 0;
  while (std::fgets(line, sizeof line, output)) {
    ended.said += line;
    if (!until.empty() && ended.said.find(until) != std::string::npos) kill(process, SIGINT);
  }
  ended.status = WEXITSTATUS(pclose(output));
  return ended;
}

TEST(RecordProgram, records_the_simulator_the_same_each_time_and_plays_it) {
  ScratchFolder folder("program");
  const std::string once = folder.file("once"), again = folder.file("again");
  const std::string simulator = "--source simulator --property clock=lockstep --property seed=4 --frames 3 ";
  EXPECT_THAT(run(simulator + once).said, HasSubstr("3 frames"));
  EXPECT_EQ(run(simulator + again).status, 0);
  const Recording first(once), second(again);
  ASSERT_EQ(first.frames().size(), 3);
  ASSERT_EQ(second.frames().size(), 3);
  std::vector<std::uint16_t> a(depth::frame_pixels), b(depth::frame_pixels);
  first.read(2, depth::FrameSpan(a));
  second.read(2, depth::FrameSpan(b));
  EXPECT_TRUE(a == b);
  EXPECT_EQ(first.frames()[2].file, second.frames()[2].file);
  const Ended played = run("--play " + once);
  EXPECT_EQ(played.status, 0);
  EXPECT_THAT(played.said, AllOf(HasSubstr("3 of 3 frames"), HasSubstr("30.0 frames a second"), HasSubstr("nearest")));
  std::filesystem::resize_file(once + "/" + first.frames()[1].file, 1000);
  const Ended damaged = run("--play " + once);
  EXPECT_EQ(damaged.status, 1);
  EXPECT_THAT(damaged.said, HasSubstr(first.frames()[1].file));
}

TEST(RecordProgram, leaves_a_whole_recording_when_it_is_interrupted) {
  ScratchFolder folder("interrupted");
  const Ended ended = run("--source simulator --frames 100000 " + folder.file("r"), "recorded ");
  EXPECT_EQ(ended.status, 0) << ended.said;
  EXPECT_THAT(ended.said, AllOf(HasSubstr("of 100000 frames"), HasSubstr("s left")));
  const Recording recording(folder.path() / "r");
  std::vector<std::uint16_t> frame(depth::frame_pixels);
  for (std::size_t i = 0; i < recording.frames().size(); ++i) recording.read(i, depth::FrameSpan(frame));
}

TEST(RecordProgram, imports_images) {
  ScratchFolder folder("import");
  std::filesystem::create_directory(folder.path() / "images");
  for (const char* name : {"images/1.pgm", "images/2.pgm"}) {
    folder.write(name, "P5 640 480 65535\n" + std::string(614'400, '\x04'));  // 1028 mm
  }
  const std::string from = "--import " + folder.file("images ");
  const Ended ended = run(from + "--unit mm --rate 10 " + folder.file("r"));
  EXPECT_EQ(ended.status, 0) << ended.said;
  const Recording recording(folder.path() / "r");
  ASSERT_EQ(recording.frames().size(), 2);
  EXPECT_EQ(recording.interval_after(0), std::chrono::milliseconds(100));
  std::vector<std::uint16_t> frame(depth::frame_pixels);
  recording.read(1, depth::FrameSpan(frame));
  EXPECT_NEAR(depth::disparity_to_mm(frame[0]), 1028, 3);

  folder.write("images/3.pgm", "P5 64 48 65535\n");
  const Ended refused = run(from + "--unit mm " + folder.file("other"));
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.said, AllOf(HasSubstr("3.pgm"), HasSubstr("64x48")));
}

TEST(RecordProgram, says_what_is_wrong_with_a_call) {
  EXPECT_EQ(run("--help").status, 0);
  EXPECT_EQ(run("").status, 2);
  EXPECT_EQ(run("--import x y").status, 2);
  const Ended kind = run("--source sonar /nonexistent/x");
  EXPECT_EQ(kind.status, 1);
  EXPECT_THAT(kind.said, AllOf(HasSubstr("sonar"), HasSubstr("kinect"), HasSubstr("recording")));
  EXPECT_THAT(run("--source simulator --property see=1 /nonexistent/x").said, HasSubstr("seed"));
  EXPECT_THAT(run("--source simulator --property seed /nonexistent/x").said, HasSubstr("key=value"));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::recording
