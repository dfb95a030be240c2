#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/drivers/ros/master.h>

/// Hides all ROS headers. This header is C++17, because ROS 1's messages do not compile as C++20.
namespace iotcloud::drivers::turtle::ros {

/// Topic names as a person writes them; the node does not use topics whose name is empty.
struct NodeTopics {
  std::string depth;     ///< sensor_msgs/Image, the node reads it
  std::string velocity;  ///< geometry_msgs/Twist, the node publishes it
  std::string odometry;  ///< nav_msgs/Odometry, the node reads it
};

/// A sensor_msgs/Image, valid during the call that passes it.
struct NodeImage {
  double stamp_s = 0;
  std::uint32_t width = 0, height = 0, step = 0;
  std::string encoding;
  bool big_endian = false;
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
};

/// A nav_msgs/Odometry: metres, radians, seconds. Vectors are x, y, z; the quaternion x, y, z, w.
struct NodeOdometry {
  double stamp_s = 0;
  std::string frame;
  std::array<double, 3> position{};
  std::array<double, 4> orientation{};
  std::array<double, 3> linear{}, angular{};
};

/// The reports of a node, on the node's own thread.
struct NodeEvents {
  std::function<void(const NodeImage&)> on_image;
  std::function<void(const NodeOdometry&)> on_odometry;
  /// One line, at each change: registered, or what the node waits for.
  std::function<void(const std::string&)> on_state;
  /// The node cannot go on. Called once, as the last event.
  std::function<void(const std::string&)> on_failed;
};

/// This process's ROS node (roscpp allows one), on a thread of its own. It waits for the master, registers, reads, and
/// registers again with a restarted master. While the master is away existing connections go on.
class RosNode {
 public:
  /// Returns at once; neither master nor topics need to exist. \throws std::runtime_error if this process has a node
  /// already.
  RosNode(drivers::ros::MasterAddress master, NodeTopics topics, NodeEvents events);
  /// Leaves the ROS graph within a few seconds, whatever the master does.
  ~RosNode();
  RosNode(const RosNode&) = delete;
  RosNode& operator=(const RosNode&) = delete;

  /// Publishes a velocity: forward in m/s, counter-clockwise in rad/s. It is lost while the node waits for its
  /// first master. Never blocks. Thread safe.
  void publish(double linear, double angular);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::drivers::turtle::ros
