#include <cmath>
#include <string>
#include <vector>

#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/turtle/options.h>

namespace iotcloud::drivers::turtle {

std::chrono::microseconds TurtleOptions::period() const {
  return std::chrono::microseconds(std::llround(1e6 / rate));
}

TurtleOptions read_options(const PropertyMap& properties, const DeviceKinds& kinds) {
  TurtleOptions options;
  PropertyReader reader(properties);
  options.broker = reader.text("broker", options.broker);
  options.rate = reader.number("rate", options.rate, 1, 120);
  options.frames = static_cast<std::uint64_t>(reader.integer("frames", 0, 0, INT64_MAX));
  const std::vector<std::string> codecs(depth::codec_names.begin(), depth::codec_names.end());
  options.codec = depth::codec_named(reader.choice("codec", "reference", codecs)).value_or(options.codec);
  options.watchdog = std::chrono::milliseconds(reader.integer("watchdog_ms", options.watchdog.count(), 20, 10'000));
  options.trace = reader.text("trace", options.trace);
  options.make_device = kinds.read(reader, options);
  reader.finish();
  return options;
}

}  // namespace iotcloud::drivers::turtle
