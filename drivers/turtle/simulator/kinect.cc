#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <iotcloud/drivers/turtle/simulator/kinect.h>
#include <iotcloud/drivers/turtle/simulator/sensor_noise.h>

namespace iotcloud::drivers::turtle::simulator {

/// For loops over the pixels of a buffer that one object owns: the thread sanitizer finds nothing in them and makes
/// them fifty times slower. Such loops call no functions, because the compiler would not inline them.
#define IOTCLOUD_PIXEL_LOOP __attribute__((no_sanitize("thread")))

namespace {

constexpr int columns = depth::frame_width;
constexpr int tile = 8;  // columns written to the frame together
constexpr float focal = static_cast<float>(depth::focal_length);
constexpr float center_x = static_cast<float>(depth::principal_x);
constexpr float center_y = static_cast<float>(depth::principal_y);
constexpr float eye = static_cast<float>(Kinect::height);

// docs/wire.md#depth-frames: z = 0.1236 tan(d / 2842.5 + 1.1863), so d = 2842.5 (atan(z / 0.1236) - 1.1863), and with
// the inverse depth w and q = 0.1236 w: atan(1 / q) = pi/2 - (q - q^3/3 + q^5/5 - q^7/7), good to 0.001 for all z >=
// 0.5 m.
constexpr float disparity_scale = 2842.5f;
constexpr float disparity_start = 1.57079633f - 1.1863f;
constexpr float inverse_scale = 0.1236f;

constexpr float noise_deviation = 0.5f;  // disparities; see Khoshelham and Elberink, Sensors 12 (2012)
constexpr float edge_step = 0.03f;       // 1/m, some ten disparities between neighbours
constexpr int edge_chance = 128;         // of 256 edge pixels have no reading
constexpr int speck_chance = 1;          // of 256 pixels have no reading
constexpr int dark_chance = 48;          // of 256 dark pixels have no reading

/// The range of disparities whose depth lies in the sensor's range.
struct Range {
  int first, last;
};
Range readable() {
  Range range{0, 0};
  for (int d = 0; d < 1024; ++d) {
    const int mm = depth::disparity_to_mm(d);
    if (mm < static_cast<int>(1000 * Kinect::nearest)) range.first = d + 1;
    if (mm <= static_cast<int>(1000 * Kinect::farthest)) range.last = d;
  }
  return range;
}

int clamp_row(float row) {
  return static_cast<int>(std::ceil(std::clamp(row, 0.0f, static_cast<float>(depth::frame_height))));
}

/// Draws a face of constant inverse depth in some rows of a column, where nothing nearer covers it.
IOTCLOUD_PIXEL_LOOP void cover(float* column, int first, int last, float inverse_depth) {
  for (int row = first; row < last; ++row) column[row] = column[row] > inverse_depth ? column[row] : inverse_depth;
}

/// Draws a level face, whose inverse depth grows with the distance from the picture's middle row.
IOTCLOUD_PIXEL_LOOP void cover_level(float* column, int first, int last, float slope) {
  for (int row = first; row < last; ++row) {
    const float inverse_depth = (static_cast<float>(row) - center_y) * slope;
    column[row] = column[row] > inverse_depth ? column[row] : inverse_depth;
  }
}

/// Writes some columns to the frame, which is stored row by row.
IOTCLOUD_PIXEL_LOOP void store(const std::uint16_t* measured, std::uint16_t* frame) {
  constexpr int rows = depth::frame_height;
  for (int row = 0; row < rows; ++row) {
    for (int i = 0; i < tile; ++i) frame[row * columns + i] = measured[i * rows + row];
  }
}

/// Turns one column of true inverse depths into the sensor's readings. `projector` holds, for each row, the smallest
/// projector column that a column further right has reached; pixels behind it are in shadow.
IOTCLOUD_PIXEL_LOOP void measure(const float* inverse_depth, const float* neighbour, float* projector, float column,
                                 const std::int8_t* noise, const std::uint8_t* chance, Range range,
                                 std::uint16_t* disparities) {
  constexpr float parallax = focal * static_cast<float>(Kinect::baseline);
  for (int row = 0; row < static_cast<int>(depth::frame_height); ++row) {
    const float w = inverse_depth[row];
    const float at_projector = column - parallax * w;
    const bool shadow = at_projector >= projector[row];
    projector[row] = shadow ? projector[row] : at_projector;
    const float change = w - neighbour[row];
    const bool edge = (change > edge_step) | (change < -edge_step);
    // The series is exact down to 0.25 m, half of the nearest reading; nearer pixels have no reading anyway.
    const float q = inverse_scale * (w < 4 ? w : 4);
    const float q2 = q * q;
    const float angle = disparity_start - q * (1 - q2 * (1.0f / 3 - q2 * (0.2f - q2 * (1.0f / 7))));
    const float exact = disparity_scale * angle;
    const float measured = exact + static_cast<float>(noise[row]) * (noise_deviation * SensorNoise::unit);
    const int disparity =
        static_cast<int>(measured + 0.5f);  // NOLINT(bugprone-incorrect-roundings): a negative value has no reading
    const int unread = edge ? edge_chance : speck_chance;
    const bool reads = !shadow & (chance[row] >= unread) & (disparity >= range.first) & (disparity <= range.last);
    disparities[row] = static_cast<std::uint16_t>(reads ? disparity : depth::no_reading);
  }
}

}  // namespace

Kinect::Kinect(std::uint64_t seed) : random_(seed) {
  SensorNoise::shared();  // made here, not in the first frame
  for (int row = 0; row < rows; ++row) {
    floor_[row] = std::max(0.0f, (static_cast<float>(row) - center_y) / (focal * eye));
  }
}

void Kinect::scan(std::span<const Prism> prisms, const Pose& camera) {
  const double forward_x = std::cos(camera.heading), forward_y = std::sin(camera.heading);
  for (const Prism& prism : prisms) {
    const double dx = prism.pose.x - camera.x, dy = prism.pose.y - camera.y;
    const double x = dx * forward_y - dy * forward_x, z = dx * forward_x + dy * forward_y;
    const bool round = prism.shape == Prism::Shape::cylinder;
    const double reach = round ? prism.half_length : std::hypot(prism.half_length, prism.half_width);
    if (z + reach < 0.05 || z - reach > Kinect::farthest + 0.5) continue;
    int first = 0, last = columns;
    const double away = std::hypot(x, z);
    if (away > reach) {
      constexpr double widest = 1.5;  // radians, below the tangent's pole
      const double bearing = std::atan2(x, z), half = std::asin(reach / away);
      const auto column = [widest](double angle) {
        return static_cast<int>(depth::principal_x +
                                depth::focal_length * std::tan(std::clamp(angle, -widest, widest)));
      };
      first = std::clamp(column(bearing - half) - 1, 0, columns);
      last = std::clamp(column(bearing + half) + 2, 0, columns);
    }
    if (first >= last) continue;
    const double turn_x = std::cos(prism.pose.heading), turn_y = std::sin(prism.pose.heading);
    Seen seen{};
    seen.x = static_cast<float>(x);
    seen.z = static_cast<float>(z);
    seen.along_x = static_cast<float>(turn_x * forward_y - turn_y * forward_x);
    seen.along_z = static_cast<float>(turn_x * forward_x + turn_y * forward_y);
    seen.half_length = static_cast<float>(prism.half_length);
    seen.half_width = static_cast<float>(prism.half_width);
    seen.side_top = focal * (eye - static_cast<float>(prism.top));
    seen.side_bottom = focal * (eye - static_cast<float>(prism.bottom));
    seen.first_column = first;
    seen.last_column = last;
    seen.round = round;
    seen.surface = prism.surface;
    seen_.push_back(seen);
  }
}

void Kinect::draw(const Seen& prism, float near, float far) {
  float* column = column_.data();
  const int top = clamp_row(center_y + prism.side_top / near);
  const int bottom = clamp_row(center_y + prism.side_bottom / near);
  cover(column, top, bottom, 1 / near);
  if (prism.side_top > 0) cover_level(column, clamp_row(center_y + prism.side_top / far), top, 1 / prism.side_top);
  if (prism.side_bottom < 0)
    cover_level(column, bottom, clamp_row(center_y + prism.side_bottom / far), 1 / prism.side_bottom);
  if (prism.surface != Surface::plain) patches_.push_back({top, bottom, 1 / near, prism.surface});
}

void Kinect::cast(int column, const Room& room, const Pose& camera, const std::uint8_t* reading_chance) {
  const float slope = (static_cast<float>(column) - center_x) / focal;  // x = slope * z along this column's ray
  // Walls, seen from inside: the place where the ray leaves the room.
  const double forward_x = std::cos(camera.heading), forward_y = std::sin(camera.heading);
  const double ray_x = forward_x + slope * forward_y, ray_y = forward_y - slope * forward_x;
  const double to_x = (std::copysign(room.half_length, ray_x) - camera.x) / (ray_x == 0 ? 1e-9 : ray_x);
  const double to_y = (std::copysign(room.half_width, ray_y) - camera.y) / (ray_y == 0 ? 1e-9 : ray_y);
  const float wall = static_cast<float>(1 / std::max(0.05, std::min(to_x, to_y)));
  column_ = floor_;
  cover(column_.data(), 0, rows, wall);

  patches_.clear();
  for (const Seen& prism : seen_) {
    if (column < prism.first_column || column >= prism.last_column) continue;
    float near = 0, far = 0;
    if (prism.round) {
      const float a = 1 + slope * slope, b = slope * prism.x + prism.z;
      const float c = prism.x * prism.x + prism.z * prism.z - prism.half_length * prism.half_length;
      const float inside = b * b - a * c;
      if (inside <= 0) continue;
      near = (b - std::sqrt(inside)) / a;
      far = (b + std::sqrt(inside)) / a;
    } else {
      // Slabs across the box's length and width; the width's direction is (-along_z, along_x).
      const auto slab = [&](float axis_x, float axis_z, float half, float& enter, float& leave) {
        const float speed = slope * axis_x + axis_z, offset = prism.x * axis_x + prism.z * axis_z;
        if (std::abs(speed) < 1e-6f) return std::abs(offset) <= half;
        const float one = (offset - half) / speed, other = (offset + half) / speed;
        enter = std::max(enter, std::min(one, other));
        leave = std::min(leave, std::max(one, other));
        return enter < leave;
      };
      far = 100;
      if (!slab(prism.along_x, prism.along_z, prism.half_length, near, far)) continue;
      if (!slab(-prism.along_z, prism.along_x, prism.half_width, near, far)) continue;
    }
    if (near > 0.05f) draw(prism, near, far);
  }
  // Removes readings of surfaces that are hard to read, where nothing covers them.
  for (const Patch& patch : patches_) {
    const int below = patch.surface == Surface::glass ? 256 : dark_chance;
    for (int row = patch.first; row < patch.last; ++row) {
      if (column_[row] == patch.inverse_depth && reading_chance[row] < below) column_[row] = 0;
    }
  }
}

void Kinect::render(const Room& room, std::span<const Prism> body, const Pose& camera, depth::FrameSpan disparities) {
  static const Range range = readable();
  const SensorNoise& field = SensorNoise::shared();
  const std::size_t noise_column = random_.next() % SensorNoise::columns;
  const std::size_t noise_row = random_.next() % (SensorNoise::rows - rows);
  const std::size_t chance_column = random_.next() % SensorNoise::columns;
  const std::size_t chance_row = random_.next() % (SensorNoise::rows - rows);

  seen_.clear();
  scan(room.furniture, camera);
  scan(body, camera);
  projector_.fill(1e9f);
  std::array<std::array<std::uint16_t, rows>, tile> measured;
  // From right to left, as the shadows fall.
  for (int left = columns - tile; left >= 0; left -= tile) {
    for (int i = tile - 1; i >= 0; --i) {
      const int column = left + i;
      const std::uint8_t* chance = field.chance(chance_column + static_cast<std::size_t>(column), chance_row);
      cast(column, room, camera, chance);
      if (column == columns - 1) neighbour_ = column_;
      measure(column_.data(), neighbour_.data(), projector_.data(), static_cast<float>(column),
              field.disparity(noise_column + static_cast<std::size_t>(column), noise_row), chance, range,
              measured[i].data());
      if (column >= columns - blind_columns) measured[i].fill(depth::no_reading);
      std::swap(column_, neighbour_);
    }
    store(measured[0].data(), disparities.data() + left);
  }
}

}  // namespace iotcloud::drivers::turtle::simulator
