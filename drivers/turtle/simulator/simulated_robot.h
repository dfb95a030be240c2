#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/simulator/world.h>

namespace iotcloud::drivers::turtle::simulator {

struct SimulatorOptions {
  std::chrono::microseconds period;  ///< between frames
  std::uint64_t seed = 1;
  bool lock_step = false;
  std::chrono::milliseconds retry{500};
  bool person_walks = false;  ///< from the start, instead of from the first command on
};

/// The kind `simulator`, with the properties `seed`, `clock`, `retry_ms` and `person`.
DeviceKind simulator_kind();

/// A simulated TurtleBot with a Kinect, paced by the driver's timers.
/// Real time: it sends a frame every period and moves the world to the frame's intended time (after a delay of the
/// host, frames and world catch up); a command acts from its arrival on.
/// Lock step: the world moves on by one period when the last frame is answered, however long that takes; if no answer
/// comes, the same frame is sent again.
class SimulatedRobot final : public DepthSource, public Actuator {
 public:
  SimulatedRobot(const SimulatorOptions& options, DriverContext& context);

  void start(std::function<void(const DepthFrame&)> on_frame) override;
  void stop() override;  ///< the world stands still until the next start()
  void answered() override;
  bool lock_step() const override { return lock_step_; }

  void drive(const Velocity& velocity) override;
  void halt() override;

 private:
  using Instant = std::chrono::steady_clock::time_point;
  void next_frame();
  void hand_over(bool repeated);
  void wait_for_answer();
  double frame_time(std::uint64_t frame) const { return static_cast<double>(frame) * period_s_; }
  void catch_up();

  DriverContext& context_;
  const std::chrono::microseconds period_, retry_;
  const double period_s_;
  const bool lock_step_;
  World world_;
  std::uint64_t frame_ = 0;  ///< number of the next frame
  std::vector<std::uint16_t> disparities_;
  GroundTruth truth_;
  Instant frame_started_{};                          ///< when the newest frame's period began
  std::function<void(const DepthFrame&)> on_frame_;  ///< empty while stopped
  std::optional<HandlerId> timer_;
  std::uint64_t run_ = 0;  ///< number of the last start(), so that callbacks of an earlier run do nothing
};

}  // namespace iotcloud::drivers::turtle::simulator
