#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/drivers/ros/master.h>

/// Hides all ROS headers. This header is C++17, as theirs are.
namespace iotcloud::drivers::ros {

/// A topic that the node publishes.
struct SentTopic {
  std::string topic;
  std::string type, checksum, definition;
  bool latch = false;  ///< whoever subscribes later gets the last message, too
};

struct NodeOptions {
  MasterAddress master;
  std::vector<std::string> read;  ///< topics, as a person writes them
  std::vector<SentTopic> sent;
  std::uint32_t queue = 100;  ///< messages of a topic that wait; the oldest of more are dropped
};

/// A message of any type, valid during the call that passes it.
struct NodeMessage {
  std::size_t topic = 0;                   ///< in NodeOptions::read
  std::string type, checksum, definition;  ///< as its publisher says
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
};

/// The reports of a node, on the node's own thread.
struct NodeEvents {
  std::function<void(const NodeMessage&)> on_message;
  /// At each change: whether the node is registered with its master, and a line with all that is missing.
  std::function<void(bool registered, const std::string& state)> on_state;
  /// The node cannot go on. Called once, as the last event.
  std::function<void(const std::string&)> on_failed;
};

/// This process's ROS node (roscpp allows one), for messages of any type, on a thread of its own. It waits for the
/// master, registers, reads, and registers again with a restarted master. While the master is away existing connections
/// go on. A publisher that was started again at the same address is found, too.
class Node {
 public:
  /// Returns at once; neither master nor topics need to exist. \throws std::runtime_error if this process has a node
  /// already.
  Node(NodeOptions options, NodeEvents events);
  /// Leaves the ROS graph within a few seconds, whatever the master does.
  ~Node();
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  /// Publishes a message of the topic's type. \param topic in NodeOptions::sent. \return false: the node still waits
  /// for its first master. Never blocks. Thread safe.
  bool publish(std::size_t topic, const std::string& bytes);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::drivers::ros
