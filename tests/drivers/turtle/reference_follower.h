#pragma once

#include <cmath>
#include <span>
#include <string>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/device.h>

namespace iotcloud::drivers::turtle {

/// The follower of docs/wire.md#follower in its simplest form: the other half of the control loop in tests of the
/// driver.
struct Followed {
  long points = 0;
  double x = 0, z = 0;  ///< centroid of the points in the box, m
  Velocity command;
  bool lost() const { return points <= 4000; }
};

inline Followed follow(depth::FrameView mm) {
  Followed result;
  for (int v = 241; v < 480; ++v) {  // in the rows above y is not positive
    for (int u = 0; u < 640; ++u) {
      const double z = mm[static_cast<std::size_t>(v * 640 + u)] / 1000.0;
      if (!(z > 0 && z < 1.0)) continue;
      const double x = (u - 320) * z / 600, y = (v - 240) * z / 600;
      if (!(x > -0.2 && x < 0.2 && y > 0.1 && y < 0.5)) continue;
      ++result.points;
      result.x += x;
      result.z += z;
    }
  }
  if (result.lost()) return result;
  result.x /= static_cast<double>(result.points);
  result.z /= static_cast<double>(result.points);
  if (std::abs(result.z - 1.0) < 0.01) return result;
  result.command.linear = result.z - 0.7;
  if (std::abs(5 * result.x) >= 0.1) result.command.angular = -5 * result.x;
  return result;
}

inline std::string as_json(const Velocity& command) {
  return "{\"linear\":{\"x\":" + std::to_string(command.linear) +
         ",\"y\":0.0,\"z\":0.0},\"angular\":{\"x\":0.0,\"y\":0.0,\"z\":" + std::to_string(command.angular) + "}}";
}

}  // namespace iotcloud::drivers::turtle
