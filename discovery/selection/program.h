#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery {

/// A compiled expression: a tree of conditions in one array, a node's children before the node.
struct Selection::Program {
  enum class Kind : std::uint8_t {
    all_of,  ///< both children
    any_of,
    none_of,  ///< `not`: its one child
    exists,
    equal,
    not_equal,
    less,
    less_equal,
    greater,
    greater_equal,
    in,
    not_in,
    starts_with,
    ends_with,
    contains,
    within_location,  ///< great circle
    within_position,  ///< plane
  };
  /// The part of a record that has a key's value.
  enum class Source : std::uint8_t { metadata, driver, gateway, instance, state };
  struct Key {
    Source source = Source::metadata;
    std::string name;  ///< the metadata's key
  };
  struct Literal {
    bool is_number = false;
    double number = 0;
    std::string text;
  };
  struct Circle {
    double first = 0;   ///< latitude, radians; x, metres
    double second = 0;  ///< longitude, radians; y, metres
    double radius = 0;  ///< metres
    double cosine = 1;  ///< cosine of the latitude
  };
  struct Node {
    Kind kind = Kind::all_of;
    std::uint32_t left = 0;   ///< a child; for comparisons the first of the key's literals; for within_* the circle
    std::uint32_t right = 0;  ///< a child; for comparisons one past the key's last literal
    Key key;
  };

  std::string text;
  std::vector<Node> nodes;  ///< the last is the root
  std::vector<Literal> literals;
  std::vector<Circle> circles;
};

namespace internal {

/// \throws SelectionError
Selection::Program compile(std::string_view text);

/// Whether the expression holds for the driver.
bool holds(const Selection::Program& program, const DriverRecord& driver) noexcept;

/// Metres on the sphere between two places in radians: haversine, with the Earth's mean radius (IUGG: 6371.0088 km).
double great_circle(double latitude, double longitude, const Selection::Program::Circle& centre) noexcept;

}  // namespace internal

}  // namespace iotcloud::discovery
