#pragma once

#include <vector>

/// The world of the simulated TurtleBot. Metres and radians; x and y on the floor, z up, headings counter-clockwise
/// from x.
namespace iotcloud::drivers::turtle::simulator {

/// A place, and the direction that something at it faces.
struct Pose {
  double x = 0, y = 0, heading = 0;
};

/// How the sensor reads a surface.
enum class Surface {
  plain,
  dark,   ///< some of its pixels have no reading
  glass,  ///< no pixel has a reading
};

/// An upright body: a box (turned by `heading`) or a cylinder, from `bottom` to `top`.
struct Prism {
  enum class Shape { box, cylinder };
  Shape shape = Shape::box;
  Pose pose;
  double half_length = 0;  ///< box: along its heading. Cylinder: the radius
  double half_width = 0;   ///< box: across its heading. Cylinder: the radius
  double bottom = 0, top = 0;
  Surface surface = Surface::plain;
};

Prism box(const Pose& pose, double length, double width, double bottom, double top, Surface surface = Surface::plain);
Prism cylinder(double x, double y, double radius, double bottom, double top, Surface surface = Surface::plain);

/// Horizontal distance from a point to a prism's footprint; 0 inside.
double distance_to(const Prism& prism, double x, double y);

/// A rectangular room around the origin, and its furniture.
struct Room {
  double half_length = 0;  ///< along x
  double half_width = 0;   ///< along y
  std::vector<Prism> furniture;
};

/// The only room: a table in the middle, furniture along the walls, and a way round the table between them.
Room living_room();

}  // namespace iotcloud::drivers::turtle::simulator
