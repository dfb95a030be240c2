#include <algorithm>
#include <cmath>

#include <iotcloud/drivers/turtle/simulator/base.h>

namespace iotcloud::drivers::turtle::simulator {

namespace {

constexpr double person_radius = 0.15;
constexpr double clearance_below = 0.35;  // m; the base passes below anything higher

/// The distance from the base to the nearest obstacle; negative inside one.
double clearance(double x, double y, const Room& room, const Pose& person) {
  double nearest = std::min(room.half_length - std::abs(x), room.half_width - std::abs(y));
  nearest = std::min(nearest, std::hypot(x - person.x, y - person.y) - person_radius);
  for (const Prism& prism : room.furniture) {
    if (prism.bottom < clearance_below) nearest = std::min(nearest, distance_to(prism, x, y));
  }
  return nearest - Base::radius;
}

double approach(double from, double to, double most) {
  return from + std::clamp(to - from, -most, most);
}

}  // namespace

void Base::command(const Velocity& velocity) {
  wanted_ = {std::clamp(velocity.linear, -top_linear, top_linear),
             std::clamp(velocity.angular, -top_angular, top_angular)};
  since_command_ = 0;
}

void Base::advance(double seconds, const Room& room, const Pose& person) {
  since_command_ += seconds;
  if (since_command_ > time_out) wanted_ = {};
  velocity_.linear = approach(velocity_.linear, wanted_.linear, linear_acceleration * seconds);
  velocity_.angular = approach(velocity_.angular, wanted_.angular, angular_acceleration * seconds);
  const double middle = pose_.heading + velocity_.angular * seconds / 2;
  const double x = pose_.x + velocity_.linear * std::cos(middle) * seconds;
  const double y = pose_.y + velocity_.linear * std::sin(middle) * seconds;
  pose_.heading = std::remainder(pose_.heading + velocity_.angular * seconds, 2 * std::acos(-1.0));
  if (velocity_.linear != 0) {
    const double there = clearance(x, y, room, person);
    // The base may always move away from what it touches.
    if (there < 0 && there < clearance(pose_.x, pose_.y, room, person)) {
      velocity_.linear = 0;
      return;
    }
  }
  pose_.x = x;
  pose_.y = y;
}

}  // namespace iotcloud::drivers::turtle::simulator
