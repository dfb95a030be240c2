#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/declared_properties.h>
#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/frame_log.h>
#include <iotcloud/drivers/turtle/options.h>

namespace iotcloud::drivers::turtle {

/// Sends depth frames to the cloud and velocities back to the robot. Needs an event thread of its own, because encoding
/// a frame, and even more so simulating one, would hold up the other instances. Stops the robot when no command has
/// come for `watchdog_ms`.
class TurtleDriver : public Driver {
 public:
  static constexpr std::string_view frames_channel = "kinect";
  static constexpr std::string_view control_channel = "control";
  static constexpr std::string_view description =
      "A TurtleBot with a Kinect, real, simulated or recorded: sends depth frames on kinect, obeys velocities on "
      "control";
  static constexpr auto declared_properties = shipped_properties;

  TurtleDriver() : TurtleDriver(shipped_kinds()) {}
  explicit TurtleDriver(DeviceKinds kinds) : kinds_(std::move(kinds)) {}

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_message(std::string_view channel, Message message) override;

 private:
  using Instant = std::chrono::steady_clock::time_point;
  void send(const DepthFrame& frame);
  PublishStatus publish(std::uint64_t sequence, std::int64_t time_ms, const DepthFrame& frame, Payload payload);
  void note_answer(const FrameRecord& record);
  void tell_position(const GroundTruth& truth);
  void guard_robot();
  void note_malformed(Instant now);
  void sum_up();

  const DeviceKinds kinds_;
  DriverContext* context_ = nullptr;
  TurtleOptions options_;
  Device device_;
  depth::DepthEncoder encoder_;
  FrameLog log_;
  std::uint64_t sequence_ = 0;  ///< number of the next frame
  std::int64_t last_time_ms_ = 0;
  std::optional<std::pair<double, double>> told_;  ///< the robot's place according to the record, metres
  std::string answers_;  ///< of frames since the last one was sent, as the property "answers" has them
  bool opened_once_ = false, active_ = false;
  std::optional<HandlerId> watchdog_;
  std::uint64_t watchdog_stops_ = 0;
  std::uint64_t malformed_ = 0;
  Instant last_malformed_{};
};

}  // namespace iotcloud::drivers::turtle
