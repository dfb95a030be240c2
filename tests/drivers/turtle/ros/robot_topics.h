#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

/// The ROS side of the simulated robot, in C++17 like all that includes ROS's messages.
namespace iotcloud::tests {

struct RobotPose {
  double x = 0, y = 0, heading = 0;  ///< m, m, rad
  double linear = 0, angular = 0;    ///< m/s, rad/s
};

/// A node that publishes what a TurtleBot's drivers publish, and obeys velocities. Not thread safe.
class RobotTopics {
 public:
  /// Waits for the master. `on_velocity` is called from spin(): m/s, rad/s.
  explicit RobotTopics(std::function<void(double linear, double angular)> on_velocity);
  ~RobotTopics();
  RobotTopics(const RobotTopics&) = delete;
  RobotTopics& operator=(const RobotTopics&) = delete;

  /// Handles messages that have arrived, or arrive within `wait_s`. \return false if the node was told to end.
  bool spin(double wait_s);
  /// Whether anybody subscribes to images.
  bool is_watched() const;
  /// 640x480 millimetres, 0 = no reading: on /camera/depth/image_raw as 16UC1, on /camera/depth/image as 32FC1, and on
  /// /camera/rgb/image_raw as an image without depth.
  void publish_image(const std::vector<std::uint16_t>& mm);
  void publish_odometry(const RobotPose& pose);  ///< on /odom

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::tests
