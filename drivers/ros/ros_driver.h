#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/ros/message_type.h>
#include <iotcloud/drivers/ros/node.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::ros {

/// A topic, and what belongs to it: the channel on which its messages are published, or its type.
struct TopicEntry {
  std::string topic, value;
  friend bool operator==(const TopicEntry&, const TopicEntry&) = default;
};

/// Reads "TOPIC[=VALUE], ...". \param fallback the value of topics without one; empty: each needs one.
/// \throws std::invalid_argument that says which entry of the property is wrong.
std::vector<TopicEntry> read_topics(const std::string& property, const std::string& text, const std::string& fallback);

/// Topics of ROS 1: README.md.
class RosDriver : public Driver {
 public:
  static constexpr std::string_view messages_channel = "messages", publish_channel = "publish";
  // Properties of a message.
  static constexpr std::string_view topic_property = "topic", type_property = "type", md5sum_property = "md5sum";
  static constexpr std::string_view description =
      "Topics of ROS 1 as channels, as JSON or as their bytes; messages on publish are published there";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "ros_master", .text = "http://HOST:11311; ROS_MASTER_URI in the host's environment"},
      PropertySpec{.name = "subscribe", .text = "TOPIC[=CHANNEL], ...: topics, and the channel of each; messages"},
      PropertySpec{.name = "publish", .text = "TOPIC=TYPE, ...: topics that messages on publish are for"},
      PropertySpec{.name = "format", .default_value = "json", .choices = {"json", "raw"}, .text = "of messages"},
      PropertySpec{.name = "msg_path",
                   .text = "FOLDER:...: where the .msg files of what is published are; those of ROS_PACKAGE_PATH, "
                           "/opt/ros/noetic/share, /usr/share"},
      PropertySpec{.name = "latch",
                   .type = PropertyType::flag,
                   .default_value = "false",
                   .text = "whoever subscribes later gets the last message that was published, too"},
      stream::most_bytes_property("of a message, both ways; a longer one is left out"),
      PropertySpec{.name = "queue",
                   .type = PropertyType::integer,
                   .unit = "messages",
                   .min = 1,
                   .max = 100'000,
                   .default_value = "100",
                   .text = "of a topic that wait while the channel is full; the oldest of more are lost"},
      stream::broker_property,
  };

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  struct Options {
    MasterAddress master;
    std::vector<TopicEntry> subscribe, publish;
    std::vector<MessageType> types;  ///< of `publish`
    bool raw = false, latch = false;
    std::size_t most_bytes = 1 << 20;
    std::uint32_t queue = 100;
    std::string broker;
  };
  /// A topic that is read. The node's thread has all of it but `waiting`.
  struct Inlet {
    std::string type_name, definition;  ///< of `type`
    std::optional<MessageType> type;
    std::string problem;          ///< why there is none
    std::deque<Message> waiting;  ///< guarded by mutex_
  };

  static Options read_options(const PropertyMap& properties);
  // On the node's thread.
  void take(const NodeMessage& message);
  Payload converted(Inlet& inlet, const NodeMessage& message) const;
  // On the event thread.
  void tell(bool registered, const std::string& state);
  void drain();
  std::string send(const Message& message);

  DriverContext* context_ = nullptr;
  Options options_;
  std::optional<stream::DeviceState> state_;
  std::optional<stream::RareLog> refused_, left_out_, lost_;
  std::vector<Inlet> inlets_;
  std::set<std::string, std::less<>> full_;  ///< channels
  std::mutex mutex_;
  bool active_ = false;  ///< guarded by mutex_
  bool told_ = false;    ///< guarded by mutex_: drain() will run
  std::unique_ptr<Node> node_;
};

}  // namespace iotcloud::drivers::ros
