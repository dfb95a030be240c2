// Depth frames of each codec as files, good and damaged ones, with what the decoder of C++ makes of them: for the test
// of the page's own decoder.
//
// usage: depth_frames FOLDER
// Writes NAME.frame, and NAME.mm (307 200 numbers of two bytes, the lower byte first) or, of a frame that is refused,
// NAME.refused.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <random>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <zlib.h>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/simulator/world.h>

namespace {

namespace depth = iotcloud::drivers::depth;
using Frame = std::vector<std::uint16_t>;
using Bytes = std::vector<std::byte>;

constexpr int damaged_of_each = 20;

class Writer {
 public:
  explicit Writer(std::filesystem::path folder) : folder_(std::move(folder)) {}

  void write(const std::string& name, std::span<const std::byte> payload) {
    put(name + ".frame", payload);
    if (decoder_.decode(payload, depth::FrameSpan(mm_)) == depth::DecodeError::none)
      put(name + ".mm", std::as_bytes(std::span(mm_)));
    else
      put(name + ".refused", {});
  }

 private:
  void put(const std::string& name, std::span<const std::byte> bytes) const {
    std::ofstream out(folder_ / name, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!out.flush()) {
      std::cerr << "depth_frames: " << (folder_ / name) << " cannot be written\n";
      std::exit(1);
    }
  }

  const std::filesystem::path folder_;
  depth::DepthDecoder decoder_;
  Frame mm_ = Frame(depth::frame_pixels);
};

/// Gives a changed payload the right checksum, so that a decoder reads on.
void seal(Bytes& payload) {
  if (payload.size() < 8 || payload[0] != std::byte{'I'}) return;
  const auto* bytes = reinterpret_cast<const Bytef*>(payload.data());
  const auto sum = crc32_z(crc32_z(0, bytes + 3, 1), bytes + 8, payload.size() - 8);
  for (int i = 0; i < 4; ++i) payload[4 + i] = static_cast<std::byte>(sum >> (8 * i) & 0xff);
}

std::vector<std::pair<std::string, Frame>> frames() {
  std::vector<std::pair<std::string, Frame>> all;
  for (const std::uint64_t seed : {1, 2, 3}) {
    iotcloud::drivers::turtle::simulator::World world(seed);
    world.command({});
    world.advance_to(static_cast<double>(seed) * 5);
    Frame frame(depth::frame_pixels);
    world.render(depth::FrameSpan(frame));
    all.emplace_back(fmt::format("room-{}", seed), frame);
  }
  std::mt19937 random(4711);
  Frame noise(depth::frame_pixels), gaps(depth::frame_pixels), slope(depth::frame_pixels);
  for (std::size_t i = 0; i < depth::frame_pixels; ++i) {
    noise[i] = static_cast<std::uint16_t>(random() % 2048);
    slope[i] = static_cast<std::uint16_t>((i % depth::frame_width) * 3 + i / depth::frame_width / 8);
    gaps[i] = random() % 3 == 0 ? depth::no_reading : static_cast<std::uint16_t>(600 + random() % 12);
  }
  all.emplace_back("noise", noise);
  all.emplace_back("gaps", gaps);
  all.emplace_back("slope", slope);
  all.emplace_back("nothing", Frame(depth::frame_pixels, depth::no_reading));
  return all;
}

}  // namespace

int main(int count, char** words) {
  if (count != 2) {
    std::cerr << "usage: depth_frames FOLDER\n";
    return 2;
  }
  Writer writer(words[1]);
  std::mt19937 random(815);
  for (const auto& [name, frame] : frames()) {
    for (const auto codec : {depth::Codec::reference, depth::Codec::compact, depth::Codec::lossless}) {
      depth::DepthEncoder encoder(codec);
      const auto payload = encoder.encode(depth::FrameView(frame));
      const auto own = fmt::format("{}-{}", name, depth::codec_names[static_cast<std::size_t>(codec)]);
      writer.write(own, payload);
      if (name != "room-1") continue;
      for (int number = 0; number < damaged_of_each; ++number) {
        Bytes damaged(payload.begin(), payload.end());
        if (number % 4 == 3)
          damaged.resize(random() % damaged.size());
        else
          damaged[number < 8 ? random() % 64 : random() % damaged.size()] ^= static_cast<std::byte>(1U << random() % 8);
        if (number % 2 == 0) seal(damaged);
        writer.write(fmt::format("damaged-{}-{}", own, number), damaged);
      }
    }
  }
  writer.write("empty", {});
  return 0;
}
