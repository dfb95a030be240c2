#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/turtle/device.h>

/// The kinds of sources and actuators that the properties `source` and `actuator` may name. A plugin with more kinds
/// than the shipped ones (for another library, say) adds them and gives the table to its driver:
///
///     struct RosTurtle : TurtleDriver {
///       RosTurtle() : TurtleDriver(shipped_kinds().with(ros_kind())) {}
///       static constexpr auto declared_properties = with_kind("ros", std::array{PropertySpec{.name = "ros_master"}});
///     };
namespace iotcloud::drivers::turtle {

struct TurtleOptions;

/// Makes a device when the instance opens, on its event thread. `context` must outlive the device.
/// \throws std::runtime_error when it cannot make the device.
using DeviceMaker = std::function<Device(DriverContext& context)>;

/// Which parts of a device the instance uses; a maker may return nullptr for the other part.
struct DeviceParts {
  bool source = false;
  bool actuator = false;
};

struct DeviceKind {
  std::string name;
  bool source = false;    ///< `source` may name it
  bool actuator = false;  ///< `actuator` may name it
  /// As an actuator it needs its own source: a real camera does not see the simulated base.
  bool pair_only = false;
  /// Asks the reader for each property of this kind (also for properties of parts that are not wanted), and keeps what
  /// it needs in the maker. `options` has what all kinds share. If an instance uses the kind as source and as actuator,
  /// there is one call and one device. \throws std::invalid_argument for a wrong value.
  std::function<DeviceMaker(PropertyReader& reader, const TurtleOptions& options, DeviceParts parts)> read;
};

/// A table of kinds. Not thread safe while it changes.
class DeviceKinds {
 public:
  /// Adds a kind, or replaces the kind of the same name. \return the table.
  DeviceKinds with(DeviceKind kind) &&;

  /// Reads `source`, `actuator` (default: the source's own, `none` if it has none) and the properties of the kinds that
  /// they name. \throws std::invalid_argument for an unknown kind (the message lists the known ones), for a pair that
  /// makes no sense, and for a wrong value.
  DeviceMaker read(PropertyReader& reader, const TurtleOptions& options) const;

 private:
  const DeviceKind& find(const std::string& name) const;
  std::vector<std::string> names(bool DeviceKind::*role) const;

  std::vector<DeviceKind> kinds_;
};

/// The kinds in turtle.so; README.md lists them.
DeviceKinds shipped_kinds();

}  // namespace iotcloud::drivers::turtle
