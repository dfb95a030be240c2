#pragma once

#include <cstdint>
#include <vector>

namespace iotcloud::drivers::turtle {

/// For each depth of 0 to 65535 mm the Kinect's disparity that comes nearest to it (depth::disparity_to_mm);
/// depth::no_reading for 0 = no reading, and for what no Kinect could say: nearer than its disparity 0 (0.3 m) or
/// farther than 1022 (5 m). Thread safe.
const std::vector<std::uint16_t>& disparities_of_mm();

}  // namespace iotcloud::drivers::turtle
