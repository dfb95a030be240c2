#pragma once

#include <chrono>
#include <string>

/// Calls to the ROS master with a limit in time. roscpp's own wait for ever when the master is frozen or its machine is
/// gone; these are made first, and roscpp's only when the master has just answered.
namespace iotcloud::drivers::turtle::ros {

struct MasterAddress {
  std::string uri;  ///< as given
  std::string host;
  int port = 0;
};

/// \param uri "http://HOST:PORT", with or without a slash at its end. roscpp ends the process for one that it cannot
/// read. \throws std::invalid_argument naming the property `ros_master`.
MasterAddress parse_master_address(const std::string& uri);

/// A topic of this node, by the names that the master knows.
struct TopicRecord {
  std::string topic;  ///< absolute
  std::string type;   ///< "geometry_msgs/Twist"
};

/// Not thread safe.
class Master {
 public:
  /// \param limit for each call. (To find a host's address by its name takes as long as the system's resolver takes.)
  Master(MasterAddress address, std::chrono::milliseconds limit) : address_(std::move(address)), limit_(limit) {}

  const MasterAddress& address() const { return address_; }
  /// \return empty when it answers; why not, otherwise: "Connection refused".
  std::string unreachable() const;

  enum class Known { yes, no, no_answer };
  /// Whether it knows a node of this name: one that was started again knows nobody.
  Known knows(const std::string& node) const;

  /// Says that this node publishes a topic. Saying it again does no harm. \return false when it did not answer.
  bool register_publisher(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const;
  /// The same for a topic that is read. Those who publish it, if there are any, are told to the node, as the master
  /// does when one comes or goes.
  bool register_subscriber(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const;

 private:
  const MasterAddress address_;
  const std::chrono::milliseconds limit_;
};

}  // namespace iotcloud::drivers::turtle::ros
