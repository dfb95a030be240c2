#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace iotcloud::drivers::turtle::simulator {

/// Fields of random numbers from which each frame cuts its noise, at a new place. Stored column by column, so that a
/// picture's column is contiguous. Immutable.
class SensorNoise {
 public:
  static constexpr std::size_t columns = 1024;  ///< wraps around
  static constexpr std::size_t rows = 1024;     ///< does not wrap: start below rows - 480
  static constexpr float unit = 1.0f / 32;      ///< disparity() counts in this many standard deviations

  /// One object for the process, made at the first call (some 30 ms). Thread safe.
  static const SensorNoise& shared();

  /// Normal noise, partly common to neighbouring pixels, as the sensor's matching windows overlap.
  const std::int8_t* disparity(std::size_t column, std::size_t row) const {
    return disparity_.data() + (column % columns) * rows + row;
  }
  /// Uniform from 0 to 255, in clumps.
  const std::uint8_t* chance(std::size_t column, std::size_t row) const {
    return chance_.data() + (column % columns) * rows + row;
  }

 private:
  SensorNoise();
  std::vector<std::int8_t> disparity_;
  std::vector<std::uint8_t> chance_;
};

}  // namespace iotcloud::drivers::turtle::simulator
