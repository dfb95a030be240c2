#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/ros/node.h>

namespace iotcloud::drivers::turtle::ros {

struct RosOptions {
  drivers::ros::MasterAddress master;
  NodeTopics topics;
  std::chrono::microseconds period{0};  ///< images that come sooner than this after the last one are left out
};

/// A robot on ROS: depth images in, velocities out, odometry on a channel of its own. The node's thread converts what
/// it receives, and hands the newest to the event thread.
class RosRobot final : public DepthSource, public Actuator {
 public:
  static constexpr std::string_view odometry_channel = "odometry";

  /// \throws std::runtime_error when this process has a ROS node already.
  RosRobot(const RosOptions& options, DriverContext& context);

  void start(std::function<void(const DepthFrame&)> on_frame) override;
  void stop() override;
  void drive(const Velocity& velocity) override;
  void halt() override;

  /// Whether the instance publishes odometry.
  void set_active(bool active) { active_ = active; }
  /// Leaves the ROS graph; no callback runs after this. Call it before the destructor, on the event thread.
  void close();

 private:
  using Instant = std::chrono::steady_clock::time_point;
  struct Frame {
    std::vector<std::uint16_t> disparities = std::vector<std::uint16_t>(depth::frame_pixels);
    Instant captured;
    double device_time_s = 0;
  };
  void take_image(const NodeImage& image);
  void refuse(const std::string& problem);
  void hand_over();
  void send_odometry(const NodeOdometry& odometry);
  void tell(const std::string& state);

  DriverContext& context_;
  const std::string depth_topic_;
  const std::chrono::microseconds period_;
  std::function<void(const DepthFrame&)> on_frame_;  ///< used by the event thread; empty while stopped
  Frame shown_;                                      ///< used by the event thread
  std::atomic<bool> wants_frames_ = false, active_ = false;
  Frame read_;     ///< used by the node's thread
  Instant due_{};  ///< used by the node's thread: the earliest time of the next image
  std::uint64_t images_ = 0, refused_ = 0, superseded_ = 0;  ///< used by the node's thread
  std::string last_problem_;                                 ///< used by the node's thread
  bool refusing_ = false;                                    ///< used by the node's thread: the last image was refused
  std::mutex mutex_;
  Frame newest_;                   ///< guarded by mutex_
  bool waiting_ = false;           ///< guarded by mutex_: the event thread has not taken newest_ yet
  std::unique_ptr<RosNode> node_;  ///< last, because its thread uses the other members
};

/// The message on the channel `odometry`: {"stamp_ms":..,"frame":..,"position":{"x","y","z"},
/// "orientation":{"x","y","z","w"},"heading":..,"linear":{..},"angular":{..}}.
std::string odometry_json(const NodeOdometry& odometry);

}  // namespace iotcloud::drivers::turtle::ros
