#include <array>
#include <fstream>
#include <stdexcept>
#include <string_view>

#include <iotcloud/drivers/camera/options.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers::camera {

namespace {

constexpr std::array<std::string_view, 6> patterns{"ball", "smpte", "snow", "black", "white", "gradient"};

void read_source(Options& options) {
  const auto begins = [&](std::string_view scheme) {
    if (!options.source.starts_with(scheme)) return false;
    options.place = options.source.substr(scheme.size());
    return true;
  };
  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument("property \"source\" is \"" + options.source + "\"; " + why);
  };
  if (begins("rtsp://")) {
    options.kind = SourceKind::rtsp;
    if (options.place.empty() || options.place.front() == '/') refuse("it names no host: rtsp://HOST[:554]/PATH");
    const auto host = options.place.substr(0, options.place.find('/'));
    if (host.find('@') != std::string::npos) {
      throw std::invalid_argument(
          "property \"source\" has a user in it, and everybody can read properties; give the properties \"user\" and "
          "\"password_file\"");
    }
    options.place = options.source;
  } else if (begins("v4l2:")) {
    options.kind = SourceKind::v4l2;
    if (!options.place.starts_with('/')) refuse("v4l2 takes the path of a device: v4l2:/dev/video0");
  } else if (begins("file:")) {
    options.kind = SourceKind::file;
    if (!options.place.starts_with('/')) refuse("file takes a path from the root: file:/srv/video.mp4");
  } else if (options.source == "test" || begins("test:")) {
    options.kind = SourceKind::test;
    if (options.place.empty()) options.place = patterns.front();
    std::string known;
    for (const std::string_view pattern : patterns) {
      if (options.place == pattern) return;
      known += (known.empty() ? "" : ", ") + std::string(pattern);
    }
    refuse("its patterns are " + known);
  } else {
    refuse("it takes v4l2:/dev/video0, rtsp://HOST[:554]/PATH, file:/PATH or test[:PATTERN]");
  }
}

std::string password_in(const std::string& file) {
  std::ifstream in(file);
  std::string password;
  if (!std::getline(in, password) || password.empty()) {
    throw std::invalid_argument("property \"password_file\": \"" + file +
                                "\" cannot be read, or its first line is empty");
  }
  return password;
}

}  // namespace

Options read_options(const PropertyMap& properties) {
  constexpr int most_pixels = 16'384, longest_wait = 600'000;
  PropertyReader reader(properties);
  Options options;
  options.source = reader.text("source", "");
  read_source(options);
  options.h264 = reader.choice("format", "jpeg", {"jpeg", "h264"}) == "h264";
  options.rate = reader.number("rate", 0, 0, 1000);
  constexpr double slowest = 0.001;
  if (options.rate > 0 && options.rate < slowest)
    throw std::invalid_argument("property \"rate\" is less than 0.001; it takes 0 (all), or 0.001 to 1000");
  options.width = static_cast<int>(reader.integer("width", 0, 0, most_pixels));
  options.height = static_cast<int>(reader.integer("height", 0, 0, most_pixels));
  options.quality = static_cast<int>(reader.integer("quality", 80, 1, 100));
  options.bitrate_kbps = static_cast<int>(reader.integer("bitrate_kbps", 1000, 1, 1'000'000));
  options.most_bytes = stream::read_most_bytes(reader);
  options.loop = reader.flag("loop", false);
  options.udp = reader.choice("transport", "tcp", {"tcp", "udp"}) == "udp";
  options.latency = std::chrono::milliseconds(reader.integer("latency_ms", 200, 0, 60'000));
  options.user = reader.text("user", "");
  const std::string file = reader.text("password_file", "");
  options.silence = std::chrono::milliseconds(reader.integer("silence_ms", 10'000, 0, longest_wait));
  options.pauses = stream::ReconnectPauses::read(reader);
  options.broker = reader.text("broker", "");
  const auto only_with = [&](bool given, const std::string& name, SourceKind kind, const std::string& what) {
    if (given && options.kind != kind)
      throw std::invalid_argument("property \"" + name + "\" is for a \"source\" that is " + what);
  };
  only_with(options.loop, "loop", SourceKind::file, "a file");
  only_with(options.udp, "transport", SourceKind::rtsp, "an RTSP camera");
  only_with(!options.user.empty(), "user", SourceKind::rtsp, "an RTSP camera");
  if (options.user.empty() != file.empty())
    throw std::invalid_argument("give both of the properties \"user\" and \"password_file\", or none");
  if (!file.empty()) options.password = password_in(file);
  // An encoder takes no picture with an odd side, and none with less than two pixels.
  for (const auto& [name, pixels] : {std::pair{"width", options.width}, std::pair{"height", options.height}}) {
    if (pixels == 1) {
      throw std::invalid_argument("property \"" + std::string(name) +
                                  "\" is 1; it takes at least 2 pixels, or 0: any size");
    }
  }
  return options;
}

}  // namespace iotcloud::drivers::camera
