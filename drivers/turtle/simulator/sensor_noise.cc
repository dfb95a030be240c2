#include <algorithm>
#include <array>
#include <cmath>

#include <iotcloud/drivers/turtle/simulator/random.h>
#include <iotcloud/drivers/turtle/simulator/sensor_noise.h>

namespace iotcloud::drivers::turtle::simulator {

namespace {

constexpr std::size_t noise_columns = SensorNoise::columns, noise_rows = SensorNoise::rows;
using Field = std::vector<float>;

/// Nearly normal numbers, mean 0, standard deviation 1: each the sum of four uniform numbers of 16 bits.
Field white(std::uint64_t seed) {
  Random random(seed);
  Field field(noise_columns * noise_rows);
  for (float& value : field) {
    const std::uint64_t bits = random.next();
    const auto sum = static_cast<float>((bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48));
    value = (sum / 65536 - 2) * std::sqrt(3.0f);
  }
  return field;
}

/// Means over a square of `side` pixels (odd), wrapped round the edges, scaled to standard deviation 1.
Field smooth(const Field& field, std::size_t side) {
  const std::size_t half = side / 2;
  Field once(field.size()), twice(field.size());
  for (std::size_t c = 0; c < noise_columns; ++c) {
    for (std::size_t r = 0; r < noise_rows; ++r) {
      float sum = 0;
      for (std::size_t k = 0; k < side; ++k) sum += field[c * noise_rows + (r + noise_rows + k - half) % noise_rows];
      once[c * noise_rows + r] = sum;
    }
  }
  for (std::size_t c = 0; c < noise_columns; ++c) {
    for (std::size_t k = 0; k < side; ++k) {
      const float* from = once.data() + (c + noise_columns + k - half) % noise_columns * noise_rows;
      float* to = twice.data() + c * noise_rows;
      for (std::size_t r = 0; r < noise_rows; ++r) to[r] += from[r];
    }
  }
  for (float& value : twice) value /= static_cast<float>(side);
  return twice;
}

}  // namespace

SensorNoise::SensorNoise() : disparity_(noise_columns * noise_rows), chance_(noise_columns * noise_rows) {
  const Field own = white(1), common = smooth(white(2), 7), clumps = smooth(white(3), 3);
  for (std::size_t i = 0; i < disparity_.size(); ++i) {
    const float value = 0.6f * own[i] + 0.8f * common[i];
    disparity_[i] = static_cast<std::int8_t>(std::clamp(std::lround(value / unit), -127l, 127l));
  }
  for (std::size_t i = 0; i < chance_.size(); ++i) {
    const float uniform = 0.5f * std::erfc(-clumps[i] / std::sqrt(2.0f));
    chance_[i] = static_cast<std::uint8_t>(std::clamp(uniform * 256, 0.0f, 255.0f));
  }
}

const SensorNoise& SensorNoise::shared() {
  static const SensorNoise noise;
  return noise;
}

}  // namespace iotcloud::drivers::turtle::simulator
