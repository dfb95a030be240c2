#include <algorithm>
#include <cmath>
#include <numbers>

#include <iotcloud/drivers/turtle/simulator/scene.h>

namespace iotcloud::drivers::turtle::simulator {

namespace {

void add_table(std::vector<Prism>& furniture) {
  furniture.push_back(box({0, 0, 0.2}, 1.0, 0.7, 0.70, 0.74));
  for (const double along : {-0.44, 0.44}) {
    for (const double across : {-0.29, 0.29}) {
      const double x = along * std::cos(0.2) - across * std::sin(0.2);
      const double y = along * std::sin(0.2) + across * std::cos(0.2);
      furniture.push_back(cylinder(x, y, 0.025, 0, 0.70));
    }
  }
}

void add_chair(std::vector<Prism>& furniture, const Pose& pose) {
  const double c = std::cos(pose.heading), s = std::sin(pose.heading);
  const auto at = [&](double along, double across) {
    return Pose{pose.x + along * c - across * s, pose.y + along * s + across * c, pose.heading};
  };
  furniture.push_back(box(pose, 0.40, 0.40, 0.40, 0.44));
  furniture.push_back(box(at(-0.18, 0), 0.03, 0.38, 0.60, 0.85));
  for (const double along : {-0.18, 0.18}) {
    for (const double across : {-0.18, 0.18}) {
      const Pose leg = at(along, across);
      furniture.push_back(cylinder(leg.x, leg.y, 0.018, 0, along < 0 ? 0.85 : 0.40));
    }
  }
}

void add_shelf(std::vector<Prism>& furniture, double x, double y) {
  constexpr double length = 1.4, depth = 0.30, height = 1.8;
  const Pose pose{x, y, 0};
  furniture.push_back(box({x - length / 2, y, 0}, 0.03, depth, 0, height));
  furniture.push_back(box({x + length / 2, y, 0}, 0.03, depth, 0, height));
  for (int board = 0; board <= 5; ++board) {
    const double level = 0.05 + 0.34 * board;
    furniture.push_back(box(pose, length, depth, level, level + 0.03));
  }
  // Rows of books, each row of its own depth and height.
  for (int row = 0; row < 5; ++row) {
    const double level = 0.08 + 0.34 * row;
    const double filled = 0.5 + 0.13 * row;
    furniture.push_back(box({x - (length - filled) / 2 + 0.03, y + 0.02 * (row % 3), 0}, filled, 0.18, level,
                            level + 0.21 + 0.02 * (row % 2), row % 2 ? Surface::dark : Surface::plain));
  }
}

void add_sofa(std::vector<Prism>& furniture, double x, double y) {
  furniture.push_back(box({x, y, 0}, 1.7, 0.55, 0.08, 0.42));
  furniture.push_back(box({x, y - 0.22, 0}, 1.7, 0.12, 0.42, 0.80));
  furniture.push_back(box({x - 0.78, y, 0}, 0.14, 0.55, 0.42, 0.60));
  furniture.push_back(box({x + 0.78, y, 0}, 0.14, 0.55, 0.42, 0.60));
  furniture.push_back(box({x + 0.35, y - 0.08, 0.5}, 0.14, 0.40, 0.42, 0.72));
}

void add_plant(std::vector<Prism>& furniture, double x, double y) {
  furniture.push_back(cylinder(x, y, 0.17, 0, 0.30));
  furniture.push_back(cylinder(x, y, 0.02, 0.30, 0.70));
  for (int leaf = 0; leaf < 6; ++leaf) {
    const double angle = leaf * std::numbers::pi / 3;
    furniture.push_back(cylinder(x + 0.16 * std::cos(angle), y + 0.16 * std::sin(angle), 0.07, 0.55 + 0.06 * leaf,
                                 0.95 + 0.08 * leaf, Surface::dark));
  }
}

}  // namespace

Prism box(const Pose& pose, double length, double width, double bottom, double top, Surface surface) {
  return {Prism::Shape::box, pose, length / 2, width / 2, bottom, top, surface};
}

Prism cylinder(double x, double y, double radius, double bottom, double top, Surface surface) {
  return {Prism::Shape::cylinder, {x, y, 0}, radius, radius, bottom, top, surface};
}

double distance_to(const Prism& prism, double x, double y) {
  const double dx = x - prism.pose.x, dy = y - prism.pose.y;
  if (prism.shape == Prism::Shape::cylinder) return std::max(0.0, std::hypot(dx, dy) - prism.half_length);
  const double c = std::cos(prism.pose.heading), s = std::sin(prism.pose.heading);
  const double along = std::max(0.0, std::abs(dx * c + dy * s) - prism.half_length);
  const double across = std::max(0.0, std::abs(dy * c - dx * s) - prism.half_width);
  return std::hypot(along, across);
}

Room living_room() {
  Room room{4.0, 3.5, {}};
  auto& furniture = room.furniture;
  add_table(furniture);
  add_chair(furniture, {0.10, -0.52, 1.7});
  add_sofa(furniture, -1.2, -3.18);
  add_shelf(furniture, 1.6, 3.33);
  add_plant(furniture, 3.55, 2.95);
  add_plant(furniture, -3.6, -3.0);
  furniture.push_back(box({-3.75, 0.4, 0}, 0.45, 1.6, 0.10, 0.55));                 // sideboard
  furniture.push_back(box({-3.78, 0.4, 0}, 0.06, 1.1, 0.62, 1.25, Surface::dark));  // its television
  furniture.push_back(box({-3.78, 0.4, 0}, 0.20, 0.4, 0.55, 0.62));                 // and the foot
  furniture.push_back(box({3.78, -1.4, 0}, 0.42, 0.9, 0.0, 1.05));                  // chest of drawers
  furniture.push_back(cylinder(3.70, -1.2, 0.09, 1.05, 1.35, Surface::glass));      // a vase on it
  furniture.push_back(box({3.99, 0.7, 0}, 0.02, 1.4, 0.85, 2.0, Surface::glass));   // window
  furniture.push_back(box({3.93, 0.7, 0}, 0.10, 1.3, 0.12, 0.70));                  // radiator below it
  furniture.push_back(box({-1.6, 3.49, 0}, 1.2, 0.02, 0.8, 1.9, Surface::glass));   // mirror
  furniture.push_back(box({-1.6, 3.32, 0}, 1.0, 0.34, 0.30, 0.46));                 // bench
  furniture.push_back(box({-2.05, 3.32, 0}, 0.06, 0.30, 0, 0.30));                  // and its legs
  furniture.push_back(box({-1.15, 3.32, 0}, 0.06, 0.30, 0, 0.30));
  furniture.push_back(cylinder(-3.5, 3.05, 0.20, 0, 2.5));  // pillar
  furniture.push_back(cylinder(0.2, -3.25, 0.02, 0, 1.5));  // floor lamp
  furniture.push_back(cylinder(0.2, -3.25, 0.17, 1.5, 1.75));
  furniture.push_back(cylinder(3.2, -3.15, 0.15, 0, 0.38));         // waste bin
  furniture.push_back(box({1.9, -3.2, 0.3}, 0.55, 0.40, 0, 0.35));  // two crates
  furniture.push_back(box({1.95, -3.22, -0.2}, 0.40, 0.35, 0.35, 0.62));
  return room;
}

}  // namespace iotcloud::drivers::turtle::simulator
