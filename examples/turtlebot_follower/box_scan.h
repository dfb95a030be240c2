#pragma once

#include <array>
#include <cstdint>

namespace turtlebot_follower {

/// Where the follower looks, in metres from the camera: x to the right, y down, z along the optical axis. The bounds
/// themselves are outside; points with z <= 0 are never in a box.
struct Box {
  double x_min = -0.2, x_max = 0.2;
  double y_min = 0.1, y_max = 0.5;
  double z_min = 0, z_max = 1.0;  ///< z_max at most farthest_box
};
/// In metres. The depths of nearer points can be added up without an overflow of the integers in BoxScan.
inline constexpr double farthest_box = 10;

/// Two implementations that give the same result: `portable` and `avx2`, which handles 16 pixels at a time.
enum class Path { portable, avx2 };
/// True if this machine can run `path`.
bool runs_here(Path path);
/// The fastest path of this machine, determined once; `portable` if the environment has IOTCLOUD_PORTABLE=1. Thread
/// safe.
Path best_path();

/// Adds up the points of a depth frame that lie in a box, in one pass over the rows and columns that the box can touch.
/// Thread safe: immutable.
class BoxScan {
 public:
  static constexpr int width = 640;
  static constexpr int height = 480;
  static constexpr double focal_length = 600;  ///< pixels
  static constexpr int centre_u = 320, centre_v = 240;

  explicit BoxScan(const Box& box);

  struct Sums {
    std::uint32_t points = 0;
    std::int64_t mm = 0;               ///< sum of their depths
    std::int64_t mm_times_column = 0;  ///< sum of depth * (column - centre_u)
  };
  /// \param depth_mm width x height millimetres, row by row; 0 = no reading.
  Sums add_up(const std::uint16_t* depth_mm, Path path = best_path()) const;

 private:
  /// A pixel (u, v) is in the box if its depth is in the range of its column (x) and in that of its row (y and z), so
  /// loops over a frame compare 16-bit integers only. The ranges are computed with the reference's double arithmetic,
  /// so exactly the same points are in the box as there.
  struct Range {
    std::uint16_t first, last;  ///< millimetres; last < first: empty
  };
  struct Row {
    Range range;
    int first_column, end_column;  ///< multiples of 16; no point outside them is in the box
  };
  static Range range_of(double factor, double low, double high, Range within);

  std::array<Row, height> rows_{};
  alignas(32) std::array<std::uint16_t, width> column_first_{};
  alignas(32) std::array<std::uint16_t, width> column_last_{};
  alignas(32) std::array<std::int16_t, width> column_weight_{};  ///< column - centre_u

  friend struct BoxScanLoops;
};

}  // namespace turtlebot_follower
