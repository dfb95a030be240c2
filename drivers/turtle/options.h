#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers::turtle {

/// A turtle instance's properties; README.md describes each.
struct TurtleOptions {
  std::string source = "simulator";
  std::string actuator = "simulator";
  std::string broker;  ///< empty: the gateway's first
  double rate = 30;    ///< frames a second
  std::uint64_t frames = 0;
  std::chrono::milliseconds watchdog{250};
  std::string trace;  ///< path; empty: none
  std::uint64_t seed = 1;
  bool lock_step = false;
  std::chrono::milliseconds retry{500};

  std::chrono::microseconds period() const;
};

/// \throws std::invalid_argument for a property that is unknown or has a wrong value, saying what would be right.
TurtleOptions read_options(const PropertyMap& properties);

}  // namespace iotcloud::drivers::turtle
