#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::drivers::turtle::recording {

/// Summarises a recording's frames. Not thread safe.
class DepthStatistics {
 public:
  void add(depth::FrameView disparities);
  /// "no reading 12.3 %, nearest 0.51 m, farthest 4.02 m; compressed 10.2 : 1".
  std::string text() const;

 private:
  depth::DepthEncoder encoder_;
  std::uint64_t frames_ = 0, readings_ = 0, payload_bytes_ = 0;
  std::uint16_t least_ = depth::no_reading, most_ = 0;  ///< among the readings
};

}  // namespace iotcloud::drivers::turtle::recording
