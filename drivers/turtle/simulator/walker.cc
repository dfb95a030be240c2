#include <algorithm>
#include <cmath>
#include <numbers>

#include <iotcloud/drivers/turtle/simulator/walker.h>

namespace iotcloud::drivers::turtle::simulator {

namespace {

constexpr double mean_radius = 1.75;   // m, of the path, across the room's width
constexpr double stretch = 1.25;       // the path is longer along the room's length
constexpr double acceleration = 0.25;  // m/s^2
constexpr double stride_length = 0.7;  // m, for both legs
constexpr double pause_share = 0.15;

}  // namespace

Walker::Walker(std::uint64_t seed) : random_(seed) {
  // The waves together stay within 0.4 m of the mean radius; the last makes the person turn left and right every metre.
  constexpr Wave largest[] = {{2, 0.15, 0}, {3, 0.10, 0}, {5, 0.07, 0}, {8, 0.06, 0}};
  for (std::size_t i = 0; i < waves_.size(); ++i) {
    waves_[i] = {largest[i].frequency, random_.uniform(0.5, 1.0) * largest[i].amplitude,
                 random_.uniform(0, 2 * std::numbers::pi)};
  }
  direction_ = random_.uniform(0, 1) < 0.5 ? -1 : 1;
  angle_ = random_.uniform(0, 2 * std::numbers::pi);
  const Point start = path(angle_);
  pose_ = {start.x, start.y, std::atan2(direction_ * start.slope_y, direction_ * start.slope_x)};
}

Walker::Point Walker::path(double angle) const {
  double radius = mean_radius, slope = 0;
  for (const Wave& wave : waves_) {
    radius += wave.amplitude * std::cos(wave.frequency * angle + wave.phase);
    slope -= wave.amplitude * wave.frequency * std::sin(wave.frequency * angle + wave.phase);
  }
  const double c = std::cos(angle), s = std::sin(angle);
  return {stretch * radius * c, radius * s, stretch * (slope * c - radius * s), slope * s + radius * c};
}

void Walker::choose_speed() {
  if (wanted_speed_ > 0 && random_.uniform(0, 1) < pause_share) {
    wanted_speed_ = 0;
    until_change_ = random_.uniform(1.0, 2.0);
  } else {
    wanted_speed_ = random_.uniform(0.1, top_speed);
    until_change_ = random_.uniform(3.0, 6.0);
  }
}

void Walker::advance(double seconds) {
  until_change_ -= seconds;
  if (until_change_ <= 0) choose_speed();
  const double change = acceleration * seconds;
  speed_ += std::clamp(wanted_speed_ - speed_, -change, change);
  const double walked = speed_ * seconds;
  // One step of the midpoint rule along the path.
  const Point here = path(angle_);
  const double half = direction_ * walked / 2 / std::hypot(here.slope_x, here.slope_y);
  const Point middle = path(angle_ + half);
  angle_ += direction_ * walked / std::hypot(middle.slope_x, middle.slope_y);
  const Point there = path(angle_);
  pose_ = {there.x, there.y, std::atan2(direction_ * there.slope_y, direction_ * there.slope_x)};
  stride_ += 2 * std::numbers::pi * walked / stride_length;
}

std::array<Pose, 2> Walker::legs() const {
  const double c = std::cos(pose_.heading), s = std::sin(pose_.heading);
  // A standing person has both feet together; a walking one swings them in turn.
  const double swing = 0.13 * std::min(1.0, speed_ / top_speed) * std::sin(stride_);
  const double side = leg_spacing / 2;
  return {Pose{pose_.x + swing * c - side * s, pose_.y + swing * s + side * c, pose_.heading},
          Pose{pose_.x - swing * c + side * s, pose_.y - swing * s - side * c, pose_.heading}};
}

void Walker::shape(std::vector<Prism>& body) const {
  body.clear();
  const double c = std::cos(pose_.heading), s = std::sin(pose_.heading);
  for (const Pose& leg : legs()) {
    body.push_back(cylinder(leg.x, leg.y, leg_radius, 0.05, 0.85));
    body.push_back(box({leg.x + 0.06 * c, leg.y + 0.06 * s, pose_.heading}, 0.26, 0.09, 0, 0.07));
  }
  body.push_back(cylinder(pose_.x, pose_.y, 0.16, 0.80, 1.45));
  for (const double side : {-0.22, 0.22}) {
    body.push_back(cylinder(pose_.x - side * s, pose_.y + side * c, 0.045, 0.70, 1.42));
  }
  body.push_back(cylinder(pose_.x, pose_.y, 0.10, 1.50, 1.75, Surface::dark));  // hair
}

}  // namespace iotcloud::drivers::turtle::simulator
