#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include <iotcloud/examples/turtlebot_follower/box_scan.h>
#include <iotcloud/topology/conf_keys.h>

namespace turtlebot_follower {

/// A command to the robot, in metres and radians a second.
struct Velocity {
  double linear = 0;   ///< forward
  double angular = 0;  ///< to the left
};

/// The reference's constants (docs/wire.md#follower), and the limits that the original did not have.
struct FollowerOptions {
  double goal_distance = 0.7;       ///< m, the distance to keep between camera and person
  double max_linear = 0.65;         ///< m/s; the base's own limit
  double max_angular = 3.14;        ///< rad/s
  double turn_gain = 5;             ///< rad/s for each metre that the person is beside the optical axis
  double min_turn = 0.1;            ///< rad/s; the robot makes no slower turns
  double stop_distance = 1.0;       ///< m: a person this far away is leaving the box, so the robot stands still
  double stop_margin = 0.01;        ///< m: largest difference from stop_distance at which it does
  std::uint32_t min_points = 4000;  ///< with this many points or fewer there is nobody to follow
  Box box;
};

/// The keys of `conf` of the bolt that follows.
std::vector<iotcloud::topology::ConfKey> follower_conf_keys();

/// Reads the options of a component's `conf`, see follower_conf_keys(). \throws iotcloud::topology::ConfErrors for
/// unknown keys, values out of range and an empty box; the message says what would be right.
FollowerOptions read_options(const std::map<std::string, std::string>& conf);

/// Finds the person in a depth frame and steers towards a fixed distance: it computes the centroid of the points in a
/// box in front of the camera and feeds a proportional controller. Thread safe: computing changes nothing.
class Follower {
 public:
  static constexpr int width = BoxScan::width;
  static constexpr int height = BoxScan::height;

  explicit Follower(FollowerOptions options = {});

  struct Result {
    Velocity velocity;
    std::uint32_t points = 0;  ///< in the box
    double x = 0, z = 0;       ///< the points' centroid, m; 0 if nobody is there
  };
  /// \param depth_mm width x height millimetres, row by row; 0 = no reading.
  Result compute(std::span<const std::uint16_t> depth_mm, Path path = best_path()) const;

 private:
  FollowerOptions options_;
  BoxScan scan_;
};

/// A command in the original's wire format: {"linear":{"x":..,"y":..,"z":..},"angular":{..}}.
std::string to_json(const Velocity& velocity);

}  // namespace turtlebot_follower
