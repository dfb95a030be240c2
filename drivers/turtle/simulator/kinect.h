#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/simulator/random.h>
#include <iotcloud/drivers/turtle/simulator/scene.h>

namespace iotcloud::drivers::turtle::simulator {

/// A simulated Kinect: renders what its camera would measure, in 11-bit disparities, at some 2 ms a frame. The camera
/// is level, so every column of the picture lies in one upright plane: a column is cast as a whole. It works in inverse
/// depth, which is constant along a column for upright faces, linear for level ones, and nearly proportional to
/// disparity.
///
/// It has these properties of the sensor: quantisation by disparity; noise of half a disparity, partly common to
/// neighbours, so in depth it grows with the square; and no reading nearer than 0.5 m or beyond 4 m, where the
/// projector's pattern is hidden from the camera (shadows beside near objects), at ragged edges, on glass, on parts of
/// dark surfaces, in specks, and in the last eight columns. Reuses its buffers. Not thread safe.
class Kinect {
 public:
  static constexpr double height = 0.45;     ///< m above the floor (docs/wire.md#follower)
  static constexpr double nearest = 0.5;     ///< m, the range of readings
  static constexpr double farthest = 4.0;    ///< m
  static constexpr double baseline = 0.075;  ///< m, from the camera to the projector at its right
  static constexpr int blind_columns = 8;    ///< at the right edge of the picture

  /// The seed determines the noise of all frames.
  explicit Kinect(std::uint64_t seed);
  /// \param camera the camera's place and direction. \param body bodies besides the room's (the person).
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
    int first_column, last_column;  ///< columns that may show it: from the first up to, not including, the last
    bool round;
    Surface surface;
  };
  /// A span of a column that shows a surface which is hard to read.
  struct Patch {
    int first, last;
    float inverse_depth;
    Surface surface;
  };

  void scan(std::span<const Prism> prisms, const Pose& camera);
  void cast(int column, const Room& room, const Pose& camera, const std::uint8_t* reading_chance);
  void draw(const Seen& prism, float near, float far);

  Random random_;
  Column floor_{};  ///< inverse depth of an empty room without walls
  std::vector<Seen> seen_;
  std::vector<Patch> patches_;
  Column column_{}, neighbour_{}, projector_{};
};

}  // namespace iotcloud::drivers::turtle::simulator
