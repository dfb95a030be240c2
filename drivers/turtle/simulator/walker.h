#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <iotcloud/drivers/turtle/simulator/random.h>
#include <iotcloud/drivers/turtle/simulator/scene.h>

namespace iotcloud::drivers::turtle::simulator {

/// A person who walks round the table on a winding closed path, at changing speed and with pauses. The seed determines
/// path, direction and speeds. Not thread safe.
class Walker {
 public:
  static constexpr double top_speed = 0.2;     ///< m/s, docs/wire.md#follower: 0.3 is the follower's limit
  static constexpr double leg_radius = 0.07;   ///< m
  static constexpr double leg_spacing = 0.18;  ///< m, between the axes of the legs
  /// How far the mean of a leg's visible half lies in front of the leg's axis: pi/4 of the radius.
  static constexpr double surface_offset = 0.055;

  explicit Walker(std::uint64_t seed);
  /// Walks on for `seconds`. Takes small steps: 0.001 to some 0.01.
  void advance(double seconds);

  Pose pose() const { return pose_; }  ///< of the vertical axis
  double speed() const { return speed_; }
  /// The axes of both legs, which swing.
  std::array<Pose, 2> legs() const;
  /// The body as the sensor sees it. Replaces the contents of `body`.
  void shape(std::vector<Prism>& body) const;

 private:
  struct Point {
    double x, y, slope_x, slope_y;  ///< the slope by the angle
  };
  Point path(double angle) const;
  void choose_speed();

  struct Wave {
    double frequency, amplitude, phase;
  };
  Random random_;
  std::array<Wave, 4> waves_{};  ///< waves of the path's radius; the frequency is for one round
  double direction_ = 1;         ///< 1: counter-clockwise
  double angle_ = 0;             ///< the place on the path, seen from the table
  Pose pose_;
  double speed_ = 0, wanted_speed_ = 0;
  double until_change_ = 1.0;  ///< s to the next choice of speed; the person stands for the first second
  double stride_ = 0;          ///< phase of the gait
};

}  // namespace iotcloud::drivers::turtle::simulator
