#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/mqtt/mqtt_client.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::mqtt {

/// A filter of topics, and the channel on which messages with such a topic are published.
struct Subscription {
  std::string filter, channel;
  friend bool operator==(const Subscription&, const Subscription&) = default;
};

/// Reads "FILTER[=CHANNEL], ...". \throws std::invalid_argument that says which filter is wrong.
std::vector<Subscription> read_subscriptions(const std::string& text);
/// Reads "TOPIC=NAME, ...": topics by name. \throws std::invalid_argument that says which one is wrong.
std::map<std::string, std::string, std::less<>> read_targets(const std::string& text);

/// Devices behind an MQTT broker: README.md.
class MqttDriver : public Driver {
 public:
  static constexpr std::string_view messages_channel = "messages";
  static constexpr std::string_view publish_channel = "publish";
  static constexpr std::string_view topic_property = "topic", retain_property = "retain", to_property = "to";
  static constexpr std::string_view description =
      "Topics of an MQTT broker as channels, by filters; messages on publish are published there";
  static constexpr auto declared_properties = with_client_properties(std::array{
      PropertySpec{.name = "subscribe", .text = "FILTER[=CHANNEL], ...: topics, and the channel of each; messages"},
      PropertySpec{.name = "qos", .default_value = "1", .choices = {"0", "1", "2"}, .text = "of what is received"},
      PropertySpec{.name = "publish_topic", .text = "topic of messages on publish that have no property topic"},
      PropertySpec{.name = "publish_to",
                   .text = "TOPIC=NAME, ...: topics of messages on publish whose property `to` is the name"},
      PropertySpec{
          .name = "publish_qos", .default_value = "1", .choices = {"0", "1", "2"}, .text = "of what is published"},
      PropertySpec{.name = "availability",
                   .text = "topic on which the device says whether it is there; it goes into the metadata `available`"},
      PropertySpec{.name = "available", .default_value = "online", .text = "what it says when it is there"},
      PropertySpec{.name = "not_available", .default_value = "offline", .text = "what it says when it is not"},
      PropertySpec{.name = "unsent_bytes",
                   .type = PropertyType::integer,
                   .unit = "bytes",
                   .min = 1,
                   .max = 64 << 20,
                   .default_value = "1048576",
                   .text = "most that waits for the broker; messages beyond are lost"},
      PropertySpec{.name = "while_away",
                   .default_value = "drop",
                   .choices = {"drop", "keep"},
                   .text = "messages on publish while the broker is away: drop them, or keep as many as unsent_bytes"},
      stream::broker_property,
  });

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  struct Options {
    ClientOptions client;
    bool keeps = false;
    std::vector<Subscription> subscriptions;
    std::map<std::string, std::string, std::less<>> publish_to;  ///< topics by name
    int qos = 1, publish_qos = 1;
    std::size_t unsent_bytes = 1 << 20;
    std::string publish_topic, availability, available, not_available, broker;
  };
  static Options read_options(const PropertyMap& properties);
  void connected();
  void received(const mosquitto_message& message, const mqtt5__property* properties);
  void sent(int number);
  void away(const std::string& reason);
  void drain();
  std::string send(const Message& message);
  std::string topic_of(const Message& message, std::string& topic) const;

  DriverContext* context_ = nullptr;
  Options options_;
  std::optional<stream::RareLog> lost_, refused_;
  bool active_ = false;
  std::deque<std::pair<std::string, Message>> pending_;  ///< received, with their channels
  std::set<std::string, std::less<>> full_;              ///< channels
  std::map<int, std::size_t> unconfirmed_;               ///< published at the broker: sizes by the client's numbers
  std::size_t unconfirmed_bytes_ = 0;
  std::deque<Message> waiting_;  ///< for a broker that is away
  std::size_t waiting_bytes_ = 0;
  std::optional<Client> client_;  ///< last, because its events use the other members
};

}  // namespace iotcloud::drivers::mqtt
