#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/driver.h>

/// What a TurtleBot consists of, as its driver sees it: a source of depth frames and an actuator, each interchangeable.
namespace iotcloud::drivers::turtle {

/// What only a simulated world knows: where things really are. Metres and radians; heading counter-clockwise from x.
struct GroundTruth {
  double robot_x = 0, robot_y = 0, robot_heading = 0;
  double person_x = 0, person_y = 0;  ///< the person's vertical axis
  /// Horizontal distance from the camera to the person's surface: to its axis, less the mean depth of the visible half
  /// of a leg before the leg's axis. This is the follower's zc (REFERENCE.md 6) without noise and code.
  double distance = 0;
  bool visible = false;  ///< the axis is in the field of view, and the distance in the sensor's range
  bool in_box = false;   ///< a leg is where the follower looks, and within the sensor's range
  double render_us = 0;  ///< time it took to simulate and render this frame
};

/// One frame, valid during the call that hands it over.
struct DepthFrame {
  /// Nothing when the frame comes encoded.
  std::optional<depth::FrameView> disparities;
  std::chrono::steady_clock::time_point captured;  ///< when the sensor had it ready
  double device_time_s = 0;                        ///< on the device's own clock
  bool repeated = false;                           ///< the last frame once more, because no command came (lock step)
  const GroundTruth* truth = nullptr;              ///< nullptr for a real device
  Payload encoded = {};                            ///< what is sent as it is when there are no disparities
};

/// A source of depth frames that runs at its own pace. All calls come from the instance's event thread.
class DepthSource {
 public:
  virtual ~DepthSource() = default;
  /// Calls `on_frame` on the event thread for each frame from now on, never from inside start().
  /// \throws std::runtime_error when the device cannot be started.
  virtual void start(std::function<void(const DepthFrame&)> on_frame) = 0;
  /// No frame comes after this; start() may follow. May be called from inside `on_frame`.
  virtual void stop() = 0;
  /// A command that answers the newest frame was given to the actuator. A source in lock step goes on now.
  virtual void answered() {}
  /// True when the device's time stands still until a frame is answered: real time-outs say nothing about it then.
  virtual bool lock_step() const { return false; }
};

/// A velocity of the base: forward and counter-clockwise. Finite.
struct Velocity {
  double linear = 0;   ///< m/s
  double angular = 0;  ///< rad/s
};

/// What moves the robot. All calls come from the instance's event thread.
class Actuator {
 public:
  virtual ~Actuator() = default;
  /// Moves so until the next call, within the base's own limits.
  virtual void drive(const Velocity& velocity) = 0;
  /// Stops as fast as the base can. Not a command: it says that none came.
  virtual void halt() = 0;
};

/// One device may be both (the simulator is): then both point to it.
struct Device {
  std::shared_ptr<DepthSource> source;
  std::shared_ptr<Actuator> actuator;
};

}  // namespace iotcloud::drivers::turtle
