#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>

#include <zlib.h>

#include <iotcloud/bench/codec/frames.h>
#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/disparities.h>
#include <iotcloud/drivers/turtle/simulator/world.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace iotcloud::bench {

namespace {

namespace depth = drivers::depth;

constexpr int commands_a_second = 10;

void follow_for_a_second(drivers::turtle::simulator::World& world, int second, Frame& frame) {
  static const turtlebot_follower::Follower follower;
  Frame mm(depth::frame_pixels);
  for (int step = 1; step <= commands_a_second; ++step) {
    world.advance_to(second + static_cast<double>(step) / commands_a_second);
    world.render(depth::FrameSpan(frame));
    std::transform(frame.begin(), frame.end(), mm.begin(),
                   [](std::uint16_t d) { return depth::disparity_mm_table()[d & depth::no_reading]; });
    const auto velocity = follower.compute(mm).velocity;
    world.command({velocity.linear, velocity.angular});
  }
}

[[noreturn]] void refuse(const std::filesystem::path& file, const std::string& why) {
  throw std::runtime_error(file.string() + ": " + why);
}

Frame read_pgm(const std::filesystem::path& file) {
  // gzopen reads plain files, too.
  const std::unique_ptr<gzFile_s, int (*)(gzFile)> in(gzopen(file.c_str(), "rb"), gzclose);
  if (!in) refuse(file, "cannot be opened");
  std::string head;
  int words = 0;
  for (bool in_word = false; words < 4;) {
    const int byte = gzgetc(in.get());
    if (byte < 0 || head.size() > 100) refuse(file, "is no binary PGM");
    const bool space = byte == ' ' || byte == '\n' || byte == '\t' || byte == '\r';
    words += in_word && space;
    head += space ? ' ' : static_cast<char>(byte);
    in_word = !space;
  }
  if (head != "P5 640 480 65535 ") refuse(file, "begins with \"" + head + "\", not with \"P5 640 480 65535 \"");
  std::vector<std::uint8_t> bytes(depth::frame_pixels * 2);
  if (gzread(in.get(), bytes.data(), static_cast<unsigned>(bytes.size())) != static_cast<int>(bytes.size())) {
    refuse(file, "is cut off");
  }
  const auto& disparities = drivers::turtle::disparities_of_mm();
  Frame frame(depth::frame_pixels);
  for (std::size_t i = 0; i < frame.size(); ++i) frame[i] = disparities[bytes[2 * i] << 8 | bytes[2 * i + 1]];
  return frame;
}

}  // namespace

std::vector<Frame> simulated_frames(int worlds, int each) {
  std::vector<Frame> frames;
  for (int seed = 1; seed <= worlds; ++seed) {
    drivers::turtle::simulator::World world(static_cast<std::uint64_t>(seed));
    for (int second = 0; second < each; ++second) {
      Frame frame(depth::frame_pixels);
      follow_for_a_second(world, second, frame);
      frames.push_back(std::move(frame));
    }
  }
  return frames;
}

std::vector<Frame> frames_of_folder(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::string name = entry.path().filename();
    if (name.ends_with(".pgm") || name.ends_with(".pgm.gz")) files.push_back(entry.path());
  }
  if (files.empty()) refuse(folder, "has no .pgm or .pgm.gz");
  std::sort(files.begin(), files.end());
  std::vector<Frame> frames;
  frames.reserve(files.size());
  for (const auto& file : files) frames.push_back(read_pgm(file));
  return frames;
}

int run_on_frames(int argc, char** argv, const std::function<int(const std::vector<Frame>&, int)>& run) {
  const int rounds = argc > 1 ? std::atoi(argv[1]) : 7;
  const int each = argc > 2 ? std::atoi(argv[2]) : 20;
  if (argc > 4 || rounds < 1 || each < 1) {
    std::fprintf(stderr, "usage: %s [ROUNDS] [SECONDS of each simulated world] [FOLDER of depth images instead]\n",
                 argv[0]);
    return 2;
  }
  try {
    return run(argc > 3 ? frames_of_folder(argv[3]) : simulated_frames(3, each), rounds);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}

}  // namespace iotcloud::bench
