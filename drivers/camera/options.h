#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::camera {

enum class SourceKind { test, v4l2, rtsp, file };

/// What the properties of a deployment say: README.md has the table.
struct Options {
  SourceKind kind = SourceKind::test;
  std::string source;  ///< as given
  std::string place;   ///< the pattern, the device, the URL or the file
  bool h264 = false;   ///< otherwise JPEG
  double rate = 0;     ///< most frames a second; 0: all
  int width = 0, height = 0, quality = 80, bitrate_kbps = 1000;
  std::size_t most_bytes = 1 << 20;
  bool loop = false, udp = false;
  std::string user, password, broker;
  std::chrono::milliseconds latency{200}, silence{10'000};
  stream::ReconnectPauses pauses;

  bool is_live() const { return kind != SourceKind::file; }
  /// Whether frames must be made anew, so that no bytes of the camera can be passed on.
  bool limits_size() const { return width > 0 || height > 0; }
};

/// \throws std::invalid_argument naming the property that is wrong.
Options read_options(const PropertyMap& properties);

}  // namespace iotcloud::drivers::camera
