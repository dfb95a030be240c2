#pragma once

#include <cstdint>
#include <vector>

#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/simulator/base.h>
#include <iotcloud/drivers/turtle/simulator/kinect.h>
#include <iotcloud/drivers/turtle/simulator/scene.h>
#include <iotcloud/drivers/turtle/simulator/walker.h>

namespace iotcloud::drivers::turtle::simulator {

/// The room, the person and the robot in simulated time. The robot starts 0.75 m behind the person and looks at it; the
/// person stands still until the first command, so that a slow start does not lose the person. The same seed and the
/// same commands at the same times give the same world. Not thread safe.
class World {
 public:
  explicit World(std::uint64_t seed);

  double time() const { return time_; }  ///< s
  /// Moves time forward to `time`; ignores earlier times.
  void advance_to(double time);
  void command(const Velocity& velocity);
  void halt() { base_.command({}); }

  /// Renders what the robot's Kinect sees now.
  void render(depth::FrameSpan disparities);
  GroundTruth truth() const;  ///< without render_us

  const Room& room() const { return room_; }
  const Walker& person() const { return person_; }
  const Base& base() const { return base_; }

 private:
  const Room room_;
  double time_ = 0;
  Walker person_;
  Base base_;
  Kinect kinect_;
  bool commanded_ = false;
  std::vector<Prism> body_;
};

}  // namespace iotcloud::drivers::turtle::simulator
