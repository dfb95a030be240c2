#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/turtle/device.h>

/// The kinds of sources and actuators that the properties `source` and `actuator` may name. A plugin that has more than
/// the shipped ones (another library's, say) adds them and gives the table to its driver:
///
///     struct RosTurtle : TurtleDriver {
///       RosTurtle() : TurtleDriver(shipped_kinds().with(ros_kind())) {}
///     };
namespace iotcloud::drivers::turtle {

struct TurtleOptions;

/// Makes a device when the instance opens, on its event thread; `context` outlives the device.
/// \throws std::runtime_error when that cannot be.
using DeviceMaker = std::function<Device(DriverContext& context)>;

/// What of a device is wanted: the other part of what a maker returns is not used, and may be nullptr.
struct DeviceParts {
  bool source = false;
  bool actuator = false;
};

struct DeviceKind {
  std::string name;
  bool source = false;    ///< `source` may name it
  bool actuator = false;  ///< `actuator` may name it
  /// As an actuator it goes with its own source only: a simulated base is seen by no real camera.
  bool pair_only = false;
  /// Asks the reader for each property that this kind has (also for those that the parts wanted do not use), and keeps
  /// what it needs in the maker. What is common to all kinds is in the options. One call, and one device, when the kind
  /// is both source and actuator of an instance. \throws std::invalid_argument for a wrong value.
  std::function<DeviceMaker(PropertyReader& reader, const TurtleOptions& options, DeviceParts parts)> read;
};

/// A table of kinds. Not thread safe while it is changed.
class DeviceKinds {
 public:
  /// This table and one more kind, or another in place of the one with this name.
  DeviceKinds with(DeviceKind kind) &&;

  /// Reads `source`, `actuator` (default: the source's own, `none` where it has none) and the properties of the kinds
  /// that they name. \throws std::invalid_argument for a kind that is not there (the message lists those that are), for
  /// a pair that makes no sense, and for a wrong value.
  DeviceMaker read(PropertyReader& reader, const TurtleOptions& options) const;

 private:
  const DeviceKind& find(const std::string& name) const;
  std::vector<std::string> names(bool DeviceKind::*role) const;

  std::vector<DeviceKind> kinds_;
};

/// What turtle.so has: README.md lists them.
DeviceKinds shipped_kinds();

}  // namespace iotcloud::drivers::turtle
