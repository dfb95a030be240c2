#include <bit>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <system_error>
#include <utility>

#include <iotcloud/drivers/turtle/recording/recording.h>

namespace iotcloud::drivers::turtle::recording {

namespace {

static_assert(std::endian::native == std::endian::little, "frames are read and written as they are in memory");

constexpr std::string_view head = "P5 640 480 65535\n";
constexpr std::size_t frame_bytes = depth::frame_pixels * sizeof(std::uint16_t);
constexpr double ticks_per_second = 60e6;  // of a Kinect's stamp
constexpr double first_seconds = 1;        // not 0, which fakenect treats specially
constexpr std::chrono::microseconds usual_interval{33'333};
constexpr double latest = 1e12;               // seconds of a frame: some 30 000 years
constexpr double shortest_interval = 0.5e-6;  // seconds: less is no microsecond

template <typename Number>
bool take_number(std::string_view& text, Number& number) {
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (status != std::errc{}) return false;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return true;
}

bool take(std::string_view& text, std::string_view expected) {
  if (!text.starts_with(expected)) return false;
  text.remove_prefix(expected.size());
  return true;
}

/// Parses a frame's file name, such as "d-1290020214.431612-2741512634.pgm".
std::optional<RecordedFrame> parse_name(std::string_view name) {
  RecordedFrame frame;
  frame.file = name;
  const bool whole = take(name, "d-") && take_number(name, frame.seconds) && take(name, "-") &&
                     take_number(name, frame.stamp) && name == ".pgm";
  if (!whole || !(std::abs(frame.seconds) <= latest)) return std::nullopt;
  return frame;
}

/// Colour and accelerometer files, which libfreenect's own recorder makes.
bool is_of_another_sensor(std::string_view name) {
  return name.starts_with("r-") || name.starts_with("a-") || name.starts_with("i-");
}

}  // namespace

Recording::Recording(std::filesystem::path folder) : folder_(std::move(folder)) {
  const auto path = folder_ / "INDEX.txt";
  std::ifstream index(path);
  if (!index) {
    throw std::runtime_error("\"" + folder_.string() + "\" is no recording: it has no INDEX.txt that can be read");
  }
  std::size_t number = 0;
  for (std::string line; std::getline(index, line);) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || is_of_another_sensor(line)) continue;
    auto frame = parse_name(line);
    if (!frame) {
      throw std::runtime_error(path.string() + ":" + std::to_string(number) + ": \"" + line.substr(0, 100) +
                               "\" is no frame's name; they are d-<seconds>-<stamp>.pgm");
    }
    frames_.push_back(std::move(*frame));
  }
  if (frames_.empty()) throw std::runtime_error(path.string() + " names no depth frame");
}

std::chrono::microseconds Recording::interval_after(std::size_t frame) const {
  for (std::size_t i = std::min(frame + 1, frames_.size() - 1); i > 0; --i) {
    const double seconds = frames_[i].seconds - frames_[i - 1].seconds;
    if (seconds >= shortest_interval) return std::chrono::microseconds(std::llround(seconds * 1e6));
  }
  return usual_interval;
}

void Recording::read(std::size_t frame, depth::FrameSpan disparities) const {
  const auto path = folder_ / frames_.at(frame).file;
  std::ifstream file(path, std::ios::binary);
  char found[head.size()];
  if (!file || !file.read(found, sizeof found)) throw std::runtime_error("cannot read a frame from " + path.string());
  if (std::string_view(found, sizeof found) != head) {
    throw std::runtime_error(path.string() + " is no frame of a recording: it does not begin with the line \"" +
                             std::string(head.substr(0, head.size() - 1)) + "\"");
  }
  file.read(reinterpret_cast<char*>(disparities.data()), static_cast<std::streamsize>(frame_bytes));
  if (static_cast<std::size_t>(file.gcount()) != frame_bytes) {
    throw std::runtime_error(path.string() + " is cut off: it has " + std::to_string(file.gcount()) + " of " +
                             std::to_string(frame_bytes) + " bytes of depth");
  }
}

RecordingWriter::RecordingWriter(std::filesystem::path folder) : folder_(std::move(folder)) {
  std::error_code error;
  std::filesystem::create_directories(folder_, error);
  if (error) throw std::runtime_error("cannot make the folder " + folder_.string() + ": " + error.message());
  const auto path = folder_ / "INDEX.txt";
  if (const auto size = std::filesystem::file_size(path, error); !error && size > 0) {
    throw std::runtime_error("there is a recording in " + folder_.string() + " already: name another folder");
  }
  index_.open(path, std::ios::binary);
  if (!index_) throw std::runtime_error("cannot write " + path.string());
}

void RecordingWriter::add(depth::FrameView disparities, double seconds) {
  char name[96];
  std::snprintf(name, sizeof name, "d-%.6f-%u.pgm", first_seconds + seconds,
                static_cast<std::uint32_t>(std::fmod(seconds * ticks_per_second, 4294967296.0)));
  const auto path = folder_ / name;
  std::ofstream file(path, std::ios::binary);
  file << head;
  file.write(reinterpret_cast<const char*>(disparities.data()), static_cast<std::streamsize>(frame_bytes));
  file.close();
  if (!file) throw std::runtime_error("cannot write " + path.string() + " (is the disk full?)");
  index_ << name << '\n' << std::flush;
  if (!index_) throw std::runtime_error("cannot write " + (folder_ / "INDEX.txt").string() + " (is the disk full?)");
  ++frames_;
}

}  // namespace iotcloud::drivers::turtle::recording
