// The follower's work on a frame, in turns with a plain pass over the same bytes: prints a line of JSON for each round.
#include <cstdio>
#include <cstring>
#include <string>

#include <iotcloud/bench/codec/contestant.h>
#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace iotcloud::bench {
namespace {

namespace depth = drivers::depth;
using turtlebot_follower::Follower;
using turtlebot_follower::Path;

constexpr int warm_passes = 20;

/// The frames as the follower gets them, and as they come from the broker.
struct Input {
  std::vector<Frame> mm;
  std::vector<std::vector<Bytes>> payloads;  ///< by codec
};

Input prepare(const std::vector<Frame>& frames) {
  Input input;
  std::vector<depth::DepthEncoder> encoders;
  for (std::size_t i = 0; i < depth::codec_names.size(); ++i) encoders.emplace_back(static_cast<depth::Codec>(i));
  input.payloads.resize(encoders.size());
  depth::DepthDecoder decoder;
  for (const Frame& frame : frames) {
    for (std::size_t i = 0; i < encoders.size(); ++i) {
      const auto payload = encoders[i].encode(depth::FrameView(frame));
      input.payloads[i].emplace_back(payload.begin(), payload.end());
    }
    Frame& mm = input.mm.emplace_back(depth::frame_pixels);
    if (decoder.decode(input.payloads[0].back(), depth::FrameSpan(mm)) != depth::DecodeError::none) std::exit(1);
  }
  return input;
}

std::uint64_t read_all(const Frame& frame) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < frame.size(); i += 4) {
    std::uint64_t word;
    std::memcpy(&word, &frame[i], sizeof word);
    sum += word;
  }
  return sum;
}

double check = 0;  ///< uses the results, so that the compiler keeps the work

/// Calls work(frame) for each frame, `passes` times in a row: the later passes find it in the cache.
template <typename Work>
void measure(const char* name, int round, const std::vector<Frame>& frames, int passes, Work work) {
  std::int64_t spent_ns = 0;
  for (const Frame& frame : frames) {
    if (passes > 1) check += work(frame);
    const std::int64_t begin = now_ns();
    for (int pass = 0; pass < passes; ++pass) check += work(frame);
    spent_ns += now_ns() - begin;
  }
  const double each = static_cast<double>(spent_ns) * 1e-6 / static_cast<double>(frames.size()) / passes;
  if (round >= 0) std::printf("{\"round\":%d,\"name\":\"%s\",\"ms\":%.5f}\n", round, name, each);
}

void measure_bolt(const std::string& codec, int round, const std::vector<Bytes>& payloads, const Follower& follower) {
  depth::DepthDecoder decoder;
  Frame mm(depth::frame_pixels);
  for (const auto& payload : payloads) {  // allocates its buffers
    if (decoder.decode(payload, depth::FrameSpan(mm)) != depth::DecodeError::none) std::exit(1);
  }
  const std::int64_t begin = now_ns();
  for (const auto& payload : payloads) {
    if (decoder.decode(payload, depth::FrameSpan(mm)) != depth::DecodeError::none) std::exit(1);
    check += follower.compute(mm).velocity.linear;
  }
  const double each = static_cast<double>(now_ns() - begin) * 1e-6 / static_cast<double>(payloads.size());
  if (round >= 0) std::printf("{\"round\":%d,\"name\":\"bolt, %s\",\"ms\":%.5f}\n", round, codec.c_str(), each);
}

int run(const std::vector<Frame>& frames, int rounds) {
  const Input input = prepare(frames);
  const Follower follower;
  const auto best = [&](const Frame& mm) { return follower.compute(mm).velocity.linear; };
  const auto portable = [&](const Frame& mm) { return follower.compute(mm, Path::portable).velocity.linear; };
  const auto reading = [](const Frame& mm) { return static_cast<double>(read_all(mm)); };
  for (int round = -1; round < rounds; ++round) {  // the first one warms up
    measure("reading, cached", round, input.mm, warm_passes, reading);
    measure("follower, cached", round, input.mm, warm_passes, best);
    measure("follower, portable, cached", round, input.mm, warm_passes, portable);
    measure("reading", round, input.mm, 1, reading);
    measure("follower", round, input.mm, 1, best);
    for (std::size_t i = 0; i < input.payloads.size(); ++i) {
      measure_bolt(std::string(depth::codec_names[i]), round, input.payloads[i], follower);
    }
  }
  std::fprintf(stderr, "%g\n", check);
  return 0;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  return iotcloud::bench::run_on_frames(argc, argv, iotcloud::bench::run);
}
