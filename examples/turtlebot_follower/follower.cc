#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace turtlebot_follower {

namespace {

// Camera (REFERENCE.md section 6): principal point and focal length in pixels.
constexpr double centre_u = 320, centre_v = 240, focal_length = 600;
constexpr int last_mm_below_one_metre = 999;

bool column_in_box(int u, int mm) {
  const double z = mm / 1000.0;
  const double x = (u - centre_u) * z / focal_length;
  return -0.2 < x && x < 0.2;
}

bool row_in_box(int v, int mm) {
  const double z = mm / 1000.0;
  const double y = (v - centre_v) * z / focal_length;
  return 0.1 < y && y < 0.5;
}

struct Sums {
  std::uint32_t points = 0;
  std::int64_t mm = 0;
  std::int64_t mm_times_column = 0;  ///< sum of mm * (u - centre)
};

/// Adds the points of one row with first <= mm <= min(last, column_last[u]). Vectorised by the compiler.
void add_row(const std::uint16_t* row, const std::uint16_t* column_last, std::uint16_t first, std::uint16_t last,
             Sums& sums) {
  std::uint32_t points = 0, mm_sum = 0;
  std::int32_t weighted = 0;  // |u - 320| * mm < 120 000 for points in the box: 640 of them fit
  for (int u = 0; u < Follower::width; ++u) {
    const std::uint16_t mm = row[u];
    const std::uint16_t kept = (mm >= first) & (mm <= last) & (mm <= column_last[u]) ? mm : std::uint16_t{0};
    points += kept != 0;
    mm_sum += kept;
    weighted += static_cast<std::int32_t>(kept) * (u - 320);
  }
  sums.points += points;
  sums.mm += mm_sum;
  sums.mm_times_column += weighted;
}

}  // namespace

Follower::Follower(FollowerOptions options) : options_(options) {
  for (int u = 0; u < width; ++u) {
    int last = last_mm_below_one_metre;
    while (last > 0 && !column_in_box(u, last)) --last;
    column_last_[u] = static_cast<std::uint16_t>(last);
  }
  for (int v = 0; v < height; ++v) {
    int first = 1;
    while (first <= last_mm_below_one_metre && !row_in_box(v, first)) ++first;
    int last = first;
    while (last <= last_mm_below_one_metre && row_in_box(v, last)) ++last;
    row_first_[v] = static_cast<std::uint16_t>(first);
    row_last_[v] = static_cast<std::uint16_t>(last - 1);
  }
}

Follower::Result Follower::compute(std::span<const std::uint16_t> depth_mm) const {
  if (depth_mm.size() != static_cast<std::size_t>(width) * height) return {};
  Sums sums;
  for (int v = 0; v < height; ++v) {
    if (row_last_[v] < row_first_[v]) continue;
    add_row(depth_mm.data() + static_cast<std::size_t>(v) * width, column_last_.data(), row_first_[v], row_last_[v],
            sums);
  }
  Result result;
  result.points = sums.points;
  if (sums.points <= options_.min_points) return result;  // nobody there: stand still

  result.z = static_cast<double>(sums.mm) / 1000.0 / sums.points;
  result.x = static_cast<double>(sums.mm_times_column) / 1000.0 / focal_length / sums.points;
  if (std::abs(result.z - 1.0) >= 0.01) {
    result.velocity.linear = std::clamp(result.z - options_.goal_distance, -options_.max_linear, options_.max_linear);
    const double turn = -5 * result.x;
    if (std::abs(turn) >= 0.1) {
      result.velocity.angular = std::clamp(turn, -options_.max_angular, options_.max_angular);
    }
  }
  return result;
}

std::string to_json(const Velocity& velocity) {
  return fmt::format(R"({{"linear":{{"x":{},"y":0.0,"z":0.0}},"angular":{{"x":0.0,"y":0.0,"z":{}}}}})", velocity.linear,
                     velocity.angular);
}

}  // namespace turtlebot_follower
