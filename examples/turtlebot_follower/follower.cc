#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace turtlebot_follower {

Follower::Follower(FollowerOptions options) : options_(options), scan_(options.box) {}

Follower::Result Follower::compute(std::span<const std::uint16_t> depth_mm, Path path) const {
  if (depth_mm.size() != static_cast<std::size_t>(width) * height) return {};
  const BoxScan::Sums sums = scan_.add_up(depth_mm.data(), path);
  Result result;
  result.points = sums.points;
  if (sums.points <= options_.min_points) return result;  // nobody is in the box: stand still

  result.z = static_cast<double>(sums.mm) / 1000.0 / sums.points;
  result.x = static_cast<double>(sums.mm_times_column) / 1000.0 / BoxScan::focal_length / sums.points;
  if (std::abs(result.z - options_.stop_distance) < options_.stop_margin) return result;
  result.velocity.linear = std::clamp(result.z - options_.goal_distance, -options_.max_linear, options_.max_linear);
  const double turn = -options_.turn_gain * result.x;
  if (std::abs(turn) >= options_.min_turn) {
    result.velocity.angular = std::clamp(turn, -options_.max_angular, options_.max_angular);
  }
  return result;
}

std::string to_json(const Velocity& velocity) {
  return fmt::format(R"({{"linear":{{"x":{},"y":0.0,"z":0.0}},"angular":{{"x":0.0,"y":0.0,"z":{}}}}})", velocity.linear,
                     velocity.angular);
}

}  // namespace turtlebot_follower
