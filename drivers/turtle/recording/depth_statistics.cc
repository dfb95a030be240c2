#include <algorithm>
#include <cstdio>

#include <iotcloud/drivers/turtle/recording/depth_statistics.h>

namespace iotcloud::drivers::turtle::recording {

namespace {

constexpr std::uint16_t first_without_reading = 1023;

}  // namespace

void DepthStatistics::add(depth::FrameView disparities) {
  ++frames_;
  for (const std::uint16_t disparity : disparities) {
    if (disparity >= first_without_reading) continue;
    ++readings_;
    least_ = std::min(least_, disparity);
    most_ = std::max(most_, disparity);
  }
  payload_bytes_ += encoder_.encode(disparities).size();
}

std::string DepthStatistics::text() const {
  if (frames_ == 0) return "no frames";
  const double pixels = static_cast<double>(frames_) * depth::frame_pixels;
  char text[160];
  if (readings_ == 0) return "no reading in any pixel";
  std::snprintf(text, sizeof text, "no reading %.1f %%, nearest %.2f m, farthest %.2f m; compressed %.1f : 1",
                100 * (1 - static_cast<double>(readings_) / pixels), depth::disparity_to_mm(least_) / 1000.0,
                depth::disparity_to_mm(most_) / 1000.0, 2 * pixels / static_cast<double>(payload_bytes_));
  return text;
}

}  // namespace iotcloud::drivers::turtle::recording
