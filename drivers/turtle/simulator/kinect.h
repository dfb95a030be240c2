#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/simulator/random.h>
#include <iotcloud/drivers/turtle/simulator/scene.h>

namespace iotcloud::drivers::turtle::simulator {

/// A Kinect: renders what its camera would measure, in 11-bit disparities, at some 2 ms a frame. Levelled, so every
/// column of the picture lies in one upright plane: a column is cast as a whole, and in inverse depth, in which upright
/// faces are constant along it, level ones linear, and the disparity is nearly so.
///
/// Of the sensor it has: quantisation by disparity; noise of half a disparity, partly common to neighbours, so in depth
/// it grows with the square; no reading nearer than 0.5 m or beyond 4 m, where the projector's pattern is hidden from
/// the camera (shadows beside what is near), at ragged edges, on glass, on parts of dark surfaces, in specks, and in
/// the last eight columns. Keeps its buffers. Not thread safe.
class Kinect {
 public:
  static constexpr double height = 0.45;     ///< m above the floor (REFERENCE.md 6)
  static constexpr double nearest = 0.5;     ///< m, the range of readings
  static constexpr double farthest = 4.0;    ///< m
  static constexpr double baseline = 0.075;  ///< m, from the camera to the projector at its right
  static constexpr int blind_columns = 8;    ///< at the right edge of the picture

  /// The noise of successive frames follows from the seed.
  explicit Kinect(std::uint64_t seed);
  /// \param camera where it stands and looks. \param body what else is there (the person).
  void render(const Room& room, std::span<const Prism> body, const Pose& camera, depth::FrameSpan disparities);

 private:
  static constexpr int rows = depth::frame_height;
  using Column = std::array<float, rows>;
  /// A prism seen from the camera: x to the right, z along the optical axis.
  struct Seen {
    float x, z;              ///< its centre
    float along_x, along_z;  ///< direction of a box's length
    float half_length, half_width;
    float side_top, side_bottom;    ///< (camera height - top) * f, (camera height - bottom) * f
    int first_column, last_column;  ///< it may be seen from the first up to, not including, the last
    bool round;
    Surface surface;
  };
  /// A span of a column that belongs to a surface which is hard to read.
  struct Patch {
    int first, last;
    float inverse_depth;
    Surface surface;
  };

  void look(std::span<const Prism> prisms, const Pose& camera);
  void cast(int column, const Room& room, const Pose& camera, const std::uint8_t* reading_chance);
  void draw(const Seen& prism, float near, float far);

  Random random_;
  Column floor_{};  ///< inverse depth of an empty room without walls
  std::vector<Seen> seen_;
  std::vector<Patch> patches_;
  Column column_{}, neighbour_{}, projector_{};
};

}  // namespace iotcloud::drivers::turtle::simulator
