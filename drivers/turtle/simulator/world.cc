#include <algorithm>
#include <cmath>

#include <iotcloud/drivers/turtle/simulator/world.h>

namespace iotcloud::drivers::turtle::simulator {

namespace {

constexpr double first_distance = 0.75;  // m, from the camera to the person's surface
constexpr double step = 0.005;           // s

Pose behind(const Pose& person) {
  const double away = first_distance + Walker::surface_offset;
  return {person.x - away * std::cos(person.heading), person.y - away * std::sin(person.heading), person.heading};
}

}  // namespace

World::World(std::uint64_t seed)
    : room_(living_room()), person_(seed), base_(behind(person_.pose())), kinect_(seed ^ 0x6b696e656374) {}

void World::advance_to(double time) {
  while (time_ < time) {
    const double seconds = std::min(step, time - time_);
    if (commanded_) person_.advance(seconds);
    base_.advance(seconds, room_, person_.pose());
    time_ = seconds < step ? time : time_ + seconds;
  }
}

void World::command(const Velocity& velocity) {
  commanded_ = true;
  base_.command(velocity);
}

void World::render(depth::FrameSpan disparities) {
  person_.shape(body_);
  kinect_.render(room_, body_, base_.pose(), disparities);
}

GroundTruth World::truth() const {
  // docs/wire.md#follower: the follower looks at -0.2 < x < 0.2 m and z < 1 m.
  constexpr double box_half_width = 0.2, box_depth = 1.0;
  GroundTruth truth;
  const Pose robot = base_.pose(), person = person_.pose();
  const double c = std::cos(robot.heading), s = std::sin(robot.heading);
  const auto along = [&](const Pose& pose) { return (pose.x - robot.x) * c + (pose.y - robot.y) * s; };
  const auto beside = [&](const Pose& pose) { return (pose.x - robot.x) * s - (pose.y - robot.y) * c; };

  truth.robot_x = robot.x;
  truth.robot_y = robot.y;
  truth.robot_heading = robot.heading;
  truth.person_x = person.x;
  truth.person_y = person.y;
  truth.distance = std::hypot(person.x - robot.x, person.y - robot.y) - Walker::surface_offset;
  const double edge = depth::principal_x / depth::focal_length;
  truth.visible = along(person) > 0 && std::abs(beside(person)) < edge * along(person) &&
                  truth.distance > Kinect::nearest && truth.distance < Kinect::farthest;
  for (const Pose& leg : person_.legs()) {
    const double surface = along(leg) - Walker::leg_radius;
    if (std::abs(beside(leg)) < box_half_width && surface > Kinect::nearest && surface < box_depth) truth.in_box = true;
  }
  return truth;
}

}  // namespace iotcloud::drivers::turtle::simulator
