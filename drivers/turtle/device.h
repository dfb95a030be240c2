#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/driver.h>

/// The parts of a TurtleBot, as its driver sees them: a source of depth frames and an actuator, each interchangeable.
namespace iotcloud::drivers::turtle {

/// Where things really are, which only a simulated world knows. Metres and radians; heading counter-clockwise from x.
struct GroundTruth {
  double robot_x = 0, robot_y = 0, robot_heading = 0;
  double person_x = 0, person_y = 0;  ///< the person's vertical axis
  /// Horizontal distance from the camera to the person's surface: to its axis, less the mean depth of the visible half
  /// of a leg before the leg's axis. This is the follower's zc (docs/wire.md#follower) without noise and code.
  double distance = 0;
  bool visible = false;  ///< the person's axis is in the field of view, and the distance is in the sensor's range
  bool in_box = false;   ///< a leg is where the follower looks, within the sensor's range
  double render_us = 0;  ///< time spent to simulate and render this frame
};

/// One frame, valid during the call that passes it.
struct DepthFrame {
  /// Empty if the frame comes encoded.
  std::optional<depth::FrameView> disparities;
  std::chrono::steady_clock::time_point captured;  ///< when the sensor finished the frame
  double device_time_s = 0;                        ///< on the device's own clock
  bool repeated = false;                           ///< the last frame again, because no command answered it (lock step)
  const GroundTruth* truth = nullptr;              ///< nullptr for a real device
  Payload encoded = {};                            ///< sent unchanged if there are no disparities
};

/// A source of depth frames that runs at its own pace. All calls come from the instance's event thread.
class DepthSource {
 public:
  virtual ~DepthSource() = default;
  /// From now on calls `on_frame` on the event thread for each frame, never from inside start().
  /// \throws std::runtime_error when the device cannot be started.
  virtual void start(std::function<void(const DepthFrame&)> on_frame) = 0;
  /// No frame comes after this; start() may follow. May be called from inside `on_frame`.
  virtual void stop() = 0;
  /// The actuator got the command that answers the newest frame. A source in lock step then goes on.
  virtual void answered() {}
  /// True if the device's time stands still until a frame is answered; real time-outs mean nothing then.
  virtual bool lock_step() const { return false; }
};

/// A velocity of the base: forward and counter-clockwise. Finite.
struct Velocity {
  double linear = 0;   ///< m/s
  double angular = 0;  ///< rad/s
};

/// The actuator, which moves the robot. All calls come from the instance's event thread.
class Actuator {
 public:
  virtual ~Actuator() = default;
  /// Moves at this velocity until the next call, within the base's own limits.
  virtual void drive(const Velocity& velocity) = 0;
  /// Stops as fast as the base can. The driver calls it when no command has come in time.
  virtual void halt() = 0;
};

/// One device may be both source and actuator (the simulator is): then both point to it.
struct Device {
  std::shared_ptr<DepthSource> source;
  std::shared_ptr<Actuator> actuator;
};

}  // namespace iotcloud::drivers::turtle
