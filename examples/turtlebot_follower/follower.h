#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace turtlebot_follower {

/// What the robot is told: metres and radians a second.
struct Velocity {
  double linear = 0;   ///< forward
  double angular = 0;  ///< to the left
};

/// The reference's constants (REFERENCE.md section 6), and the limits that the original did not have.
struct FollowerOptions {
  double goal_distance = 0.7;       ///< m, kept between camera and person
  double max_linear = 0.65;         ///< m/s; the base's own limit
  double max_angular = 3.14;        ///< rad/s
  std::uint32_t min_points = 4000;  ///< with this many or fewer there is nobody to follow
};

/// Finds the person in a depth frame and steers towards a fixed distance: the centroid of the points in a box in front
/// of the camera (-0.2 < x < 0.2 m, 0.1 < y < 0.5 m below the optical axis, 0 < z < 1 m), then a proportional
/// controller. Thread safe: computing changes nothing.
class Follower {
 public:
  static constexpr int width = 640;
  static constexpr int height = 480;

  explicit Follower(FollowerOptions options = {});

  struct Result {
    Velocity velocity;
    std::uint32_t points = 0;  ///< in the box
    double x = 0, z = 0;       ///< their centroid, m; 0 when there is nobody
  };
  /// \param depth_mm width x height millimetres, row by row; 0 = no reading.
  Result compute(std::span<const std::uint16_t> depth_mm) const;

 private:
  FollowerOptions options_;
  // The box as a range of millimetres for each row (y) and a bound for each column (x), so that the loop over a frame
  // compares 16-bit integers only. Made with the reference's double arithmetic: the same points are kept, exactly.
  std::array<std::uint16_t, height> row_first_{};
  std::array<std::uint16_t, height> row_last_{};  ///< last < first: no point of this row is in the box
  std::array<std::uint16_t, width> column_last_{};
};

/// The command on the wire, as in the original: {"linear":{"x":..,"y":..,"z":..},"angular":{..}}.
std::string to_json(const Velocity& velocity);

}  // namespace turtlebot_follower
