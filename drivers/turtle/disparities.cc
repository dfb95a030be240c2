#include <cstdlib>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/disparities.h>

namespace iotcloud::drivers::turtle {

const std::vector<std::uint16_t>& disparities_of_mm() {
  static const auto table = [] {
    constexpr int last = 1022;  // the codec takes larger values as no reading
    std::vector<std::uint16_t> nearest(65536, depth::no_reading);
    int disparity = 0;
    for (int mm = depth::disparity_to_mm(0); mm <= depth::disparity_to_mm(last); ++mm) {
      const auto miss = [mm](int d) { return std::abs(depth::disparity_to_mm(d) - mm); };
      // Depth never falls as disparity grows, so the nearest disparity is never below that of the previous mm.
      while (disparity < last && miss(disparity + 1) <= miss(disparity)) ++disparity;
      nearest[static_cast<std::size_t>(mm)] = static_cast<std::uint16_t>(disparity);
    }
    return nearest;
  }();
  return table;
}

}  // namespace iotcloud::drivers::turtle
