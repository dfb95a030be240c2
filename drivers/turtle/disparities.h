#pragma once

#include <cstdint>
#include <vector>

namespace iotcloud::drivers::turtle {

/// For each depth of 0 to 65535 mm the Kinect disparity whose depth (depth::disparity_to_mm) is nearest;
/// depth::no_reading for 0 = no reading, and for depths that no Kinect measures: nearer than disparity 0 (0.3 m) or
/// farther than 1022 (5 m). Thread safe.
const std::vector<std::uint16_t>& disparities_of_mm();

}  // namespace iotcloud::drivers::turtle
