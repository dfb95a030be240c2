// This project's codecs and their peers on the same depth frames, in turns: prints a line of JSON for each codec and
// round.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>

#include <iotcloud/bench/codec/contestant.h>
#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/depth/inversion.h>

namespace iotcloud::bench {
namespace {

namespace depth = drivers::depth;

double milliseconds_since(std::int64_t begin_ns) {
  return static_cast<double>(now_ns() - begin_ns) * 1e-6;
}

/// The size and exactness of a contestant's frames, the same in every round.
struct Quality {
  std::size_t bytes = 0, largest = 0;  ///< of all frames, and of the largest
  double worst_mm = 0, squares = 0;    ///< of readings that came back
  std::size_t readings = 0, lost = 0;

  void add(const Frame& sent, const Frame& back, bool in_mm) {
    for (std::size_t i = 0; i < sent.size(); ++i) {
      const auto& mm = depth::disparity_mm_table();
      const int true_mm = mm[sent[i] & depth::no_reading];
      if (true_mm == 0) continue;
      ++readings;
      const int got_mm = in_mm ? back[i] : mm[back[i] & depth::no_reading];
      if (got_mm == 0) {
        ++lost;
        continue;
      }
      const double error = std::abs(got_mm - true_mm);
      worst_mm = std::max(worst_mm, error);
      squares += error * error;
    }
  }
  double rms_mm() const { return std::sqrt(squares / static_cast<double>(std::max<std::size_t>(readings - lost, 1))); }
};

/// Runs a contestant over all frames. The clock runs only while it works.
void turn(const Named& named, const std::vector<Frame>& frames, int round, Quality& quality) {
  std::vector<Bytes> payloads(frames.size());
  Bytes out;
  Frame back(depth::frame_pixels);
  double encode_ms = 0, decode_ms = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::int64_t begin = now_ns();
    named.contestant->encode(frames[i], out);
    encode_ms += milliseconds_since(begin);
    payloads[i] = out;
  }
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::int64_t begin = now_ns();
    named.contestant->decode(payloads[i], back);
    decode_ms += milliseconds_since(begin);
    if (round >= 0) continue;
    quality.add(frames[i], back, named.contestant->gives_mm());
    quality.bytes += payloads[i].size();
    quality.largest = std::max(quality.largest, payloads[i].size());
  }
  if (round < 0) return;
  const auto count = static_cast<double>(frames.size());
  std::printf("{\"round\":%d,\"name\":\"%s\",\"encode_ms\":%.5f,\"decode_ms\":%.5f}\n", round, named.name.c_str(),
              encode_ms / count, decode_ms / count);
}

/// Measures the steps of the reference, and a plain copy of the same bytes.
void steps(const std::vector<Frame>& frames, int round) {
  Frame copy(depth::frame_pixels);
  std::vector<std::uint8_t> codes(depth::frame_pixels);
  double copy_ms = 0, inversion_ms = 0, portable_ms = 0;
  for (const Frame& frame : frames) {
    std::int64_t begin = now_ns();
    std::memcpy(copy.data(), frame.data(), frame.size() * sizeof frame[0]);
    copy_ms += milliseconds_since(begin);
    begin = now_ns();
    depth::to_codes(depth::best_path(), depth::FrameView(frame), codes.data());
    inversion_ms += milliseconds_since(begin);
    begin = now_ns();
    depth::to_codes(depth::Path::portable, depth::FrameView(frame), codes.data());
    portable_ms += milliseconds_since(begin);
  }
  if (round < 0) return;
  const auto count = static_cast<double>(frames.size());
  std::printf(
      "{\"round\":%d,\"name\":\"copy\",\"ms\":%.5f}\n{\"round\":%d,\"name\":\"inversion\",\"ms\":%.5f}\n"
      "{\"round\":%d,\"name\":\"inversion, portable\",\"ms\":%.5f}\n",
      round, copy_ms / count, round, inversion_ms / count, round, portable_ms / count);
}

int run(const std::vector<Frame>& frames, int rounds) {
  std::vector<Named> all = all_contestants();
  std::vector<Quality> qualities(all.size());
  for (int round = -1; round < rounds; ++round) {  // the first round warms up and checks the decoded frames
    steps(frames, round);
    for (std::size_t i = 0; i < all.size(); ++i) {
      const std::size_t at = round % 2 == 0 ? i : all.size() - 1 - i;
      turn(all[at], frames, round, qualities[at]);
    }
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Quality& quality = qualities[i];
    const auto count = static_cast<double>(frames.size());
    const double raw = depth::frame_pixels * sizeof(std::uint16_t);
    std::printf(
        "{\"name\":\"%s\",\"frames\":%zu,\"bytes\":%.0f,\"ratio\":%.4f,\"worst_ratio\":%.4f,\"max_error_mm\":%.0f,"
        "\"rms_error_mm\":%.3f,\"lost_percent\":%.4f}\n",
        all[i].name.c_str(), frames.size(), static_cast<double>(quality.bytes) / count,
        raw * count / static_cast<double>(quality.bytes), raw / static_cast<double>(quality.largest), quality.worst_mm,
        quality.rms_mm(),
        100.0 * static_cast<double>(quality.lost) / static_cast<double>(std::max<std::size_t>(quality.readings, 1)));
  }
  return 0;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  return iotcloud::bench::run_on_frames(argc, argv, iotcloud::bench::run);
}
