#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/device_kinds.h>

namespace iotcloud::drivers::turtle {

/// A turtle instance's properties that do not depend on source and actuator; README.md describes each.
struct TurtleOptions {
  std::string broker;  ///< empty: the gateway's first
  double rate = 30;    ///< frames a second
  std::uint64_t frames = 0;
  depth::Codec codec = depth::Codec::reference;
  std::chrono::milliseconds watchdog{250};
  std::string trace;        ///< path; empty: no trace
  DeviceMaker make_device;  ///< makes the device that `source` and `actuator` name

  std::chrono::microseconds period() const;
};

/// \throws std::invalid_argument for an unknown property or a wrong value; the message says what would be right.
TurtleOptions read_options(const PropertyMap& properties, const DeviceKinds& kinds);

}  // namespace iotcloud::drivers::turtle
