#pragma once

#include <vector>

#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/simulator/scene.h>

namespace iotcloud::drivers::turtle::simulator {

/// The TurtleBot's base: differential drive with limits, its own time-out, and bumpers. Not thread safe.
class Base {
 public:
  static constexpr double top_linear = 0.65;           ///< m/s (a Kobuki's)
  static constexpr double top_angular = 3.0;           ///< rad/s
  static constexpr double linear_acceleration = 0.8;   ///< m/s^2
  static constexpr double angular_acceleration = 6.0;  ///< rad/s^2
  static constexpr double time_out = 0.6;  ///< s; without a command for this long the base stops by itself (a Kobuki's)
  static constexpr double radius = 0.18;   ///< m

  explicit Base(const Pose& start) : pose_(start) {}
  /// Clamps the velocity to the limits.
  void command(const Velocity& velocity);
  /// Moves the base. It does not enter furniture, walls or the person: there it only turns.
  void advance(double seconds, const Room& room, const Pose& person);

  Pose pose() const { return pose_; }
  Velocity velocity() const { return velocity_; }

 private:
  Pose pose_;
  Velocity velocity_;
  Velocity wanted_;
  double since_command_ = 0;
};

}  // namespace iotcloud::drivers::turtle::simulator
