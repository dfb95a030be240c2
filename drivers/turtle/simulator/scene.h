#pragma once

#include <vector>

/// The world of the simulated TurtleBot. Metres and radians; x and y on the floor, z up, headings counter-clockwise
/// from x.
namespace iotcloud::drivers::turtle::simulator {

/// Where something stands, and which way it looks.
struct Pose {
  double x = 0, y = 0, heading = 0;
};

/// What of a surface the sensor cannot read.
enum class Surface {
  plain,
  dark,   ///< a part of its pixels has no reading
  glass,  ///< none has
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

/// A rectangular room around the origin, and what stands in it.
struct Room {
  double half_length = 0;  ///< along x
  double half_width = 0;   ///< along y
  std::vector<Prism> furniture;
};

/// The one room there is: a table in the middle, furniture along the walls, and a way round the table between them.
Room living_room();

}  // namespace iotcloud::drivers::turtle::simulator
