#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/drivers/turtle/ros/master.h>

/// All that includes ROS is behind this header, which is C++17 for that: the messages of ROS 1 do not compile in C++20.
namespace iotcloud::drivers::turtle::ros {

/// Names as a person writes them; an empty one is not wanted.
struct NodeTopics {
  std::string depth;     ///< sensor_msgs/Image, read
  std::string velocity;  ///< geometry_msgs/Twist, published
  std::string odometry;  ///< nav_msgs/Odometry, read
};

/// Empty for what may be the name of a topic.
std::string problem_of_topic(const std::string& name);

/// A sensor_msgs/Image, valid during the call that hands it over.
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

/// What a node tells, on its own thread.
struct NodeEvents {
  std::function<void(const NodeImage&)> on_image;
  std::function<void(const NodeOdometry&)> on_odometry;
  /// In one line, at each change: registered, or for what it waits.
  std::function<void(const std::string&)> on_state;
  /// It cannot go on. Once, last.
  std::function<void(const std::string&)> on_failed;
};

/// This process's ROS node (roscpp allows one), on a thread of its own: it waits for the master, registers, reads, and
/// registers again with a master that was started anew. While the master is away what is connected goes on.
class Node {
 public:
  /// Returns at once; nothing needs to be there. \throws std::runtime_error when this process has a node already.
  Node(MasterAddress master, NodeTopics topics, NodeEvents events);
  /// Leaves the graph, within a few seconds at the most, whatever the master does.
  ~Node();
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  /// To all who listen to the velocity topic: forward in m/s, counter-clockwise in rad/s. To nobody while the node
  /// waits for its first master. Never blocks. Thread safe.
  void publish(double linear, double angular);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::drivers::turtle::ros
