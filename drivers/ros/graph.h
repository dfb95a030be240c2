#pragma once

#include <memory>

#include <ros/callback_queue.h>
#include <ros/node_handle.h>

#include <iotcloud/drivers/ros/master.h>

/// For sources that include ROS anyway. This header is C++17, because ROS 1's messages do not compile as C++20.
namespace iotcloud::drivers::ros {

/// This process's node in the graph of ROS, of which roscpp allows one. The node's own thread makes all calls but the
/// first.
class Graph {
 public:
  /// \param name of the node; ROS puts a number behind it. \param plugin for messages. \throws std::runtime_error if
  /// this process has a node already
  Graph(const Master& master, const char* name, const char* plugin);
  ~Graph();
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;

  /// Call it when the master has answered for the first time: roscpp waits for one for ever.
  void join();
  bool has_joined() const { return handle_ != nullptr; }
  ::ros::NodeHandle& handle() { return *handle_; }
  /// Runs what has come, or waits for it for a moment. \throws std::runtime_error when somebody has told the node to
  /// end
  void work();
  static const std::string& name();
  static std::string uri();  ///< of this node, for the master
  /// Ends all connections, and says farewell to a master that answers. Then drop subscribers, publishers and this
  /// object.
  void leave();

 private:
  const Master& master_;
  ::ros::CallbackQueue queue_;
  std::unique_ptr<::ros::NodeHandle> handle_;
};

}  // namespace iotcloud::drivers::ros
