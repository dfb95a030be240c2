#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

/// Calls to the ROS master with a time limit. roscpp's own calls wait for ever when the master is frozen or its machine
/// is gone; so make these calls first, and call roscpp only right after the master has answered.
namespace iotcloud::drivers::ros {

struct MasterAddress {
  std::string uri;  ///< as given
  std::string host;
  int port = 0;
};

/// \param uri "http://HOST:PORT", with or without a slash at its end. roscpp ends the process for a URI that it cannot
/// read. \throws std::invalid_argument naming the property `ros_master`.
MasterAddress parse_master_address(const std::string& uri);
/// ROS_MASTER_URI in this process's environment, or what ROS has without it.
std::string default_master();

/// \return empty if `name` may be a topic's name, otherwise what is wrong with it.
std::string problem_of_topic(const std::string& name);

/// A topic of this node, as the master knows it.
struct TopicRecord {
  std::string topic;  ///< absolute
  std::string type;   ///< "geometry_msgs/Twist"
};

/// Not thread safe.
class Master {
 public:
  /// \param limit for each call, without the time that the system's resolver takes to look up a host's address.
  Master(MasterAddress address, std::chrono::milliseconds limit) : address_(std::move(address)), limit_(limit) {}

  const MasterAddress& address() const { return address_; }
  std::chrono::milliseconds limit() const { return limit_; }
  /// \return empty if the master answers, otherwise the reason: "Connection refused".
  std::string unreachable() const;

  enum class Known { yes, no, no_answer };
  /// Whether the master knows a node of this name: a restarted master knows none.
  Known knows(const std::string& node) const;

  /// Registers this node as a topic's publisher. Repeating it does no harm. \return false if the master did not answer.
  bool register_publisher(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const;
  /// Registers this node as a topic's subscriber, and tells the node who publishes the topic, if anyone does, as the
  /// master does when a publisher comes or goes.
  bool register_subscriber(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const;
  /// The addresses of the nodes that publish a topic of which this node is a subscriber; empty also when the master
  /// does not answer.
  std::vector<std::string> publishers_of(const std::string& node, const TopicRecord& topic,
                                         const std::string& node_uri) const;
  /// The number of the process of the node at this address; nullopt: it does not answer.
  std::optional<int> process_at(const std::string& node_uri) const;

 private:
  const MasterAddress address_;
  const std::chrono::milliseconds limit_;
};

}  // namespace iotcloud::drivers::ros
