#pragma once

#include <array>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/mqtt/finder/announcements.h>
#include <iotcloud/drivers/mqtt/mqtt_client.h>
#include <iotcloud/drivers/mqtt/sparkplug/sparkplug.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::mqtt {

/// Finds devices that announce themselves at an MQTT broker: README.md.
class MqttFinder : public Driver {
 public:
  static constexpr std::string_view description =
      "Finds devices that announce themselves at an MQTT broker: Home Assistant's discovery, Sparkplug B, JSON objects";
  static constexpr auto declared_properties = with_client_properties(std::array{
      PropertySpec{.name = "find",
                   .required = true,
                   .text = "homeassistant, sparkplug, announcements: the ways of announcing, separated by commas"},
      PropertySpec{.name = "homeassistant_prefix", .default_value = "homeassistant", .text = "of discovery topics"},
      PropertySpec{.name = "announcements", .text = "filter of the topics on which devices announce JSON objects"},
  });

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void close() override { client_.reset(); }

 private:
  struct Options {
    ClientOptions client;
    bool homeassistant = false, sparkplug = false;
    std::string prefix, announcements;
  };
  using NodeName = std::pair<std::string, std::string>;  ///< group and node
  static Options read_options(const PropertyMap& properties);
  void connected();
  void received(const std::string& topic, std::string_view payload, bool retained);
  void sparkplug_received(const sparkplug::Topic& topic, std::string_view payload);
  void found_sparkplug(const sparkplug::Topic& topic, const sparkplug::Payload& payload);
  void gone_sparkplug(const sparkplug::Topic& topic);
  void ask_for_births(const NodeName& node);
  void forget_node(const NodeName& node);

  static constexpr std::size_t most_nodes = 10'000;
  static constexpr std::size_t most_known = std::size_t{256} << 20;  ///< bytes of all nodes together, about

  DriverContext* context_ = nullptr;
  Options options_;
  std::optional<stream::RareLog> passed_over_;
  std::optional<PlainAnnouncements> plain_;
  std::optional<HomeAssistant> homeassistant_;
  std::map<NodeName, sparkplug::Node> nodes_;
  std::size_t known_ = 0;                              ///< bytes of all nodes together
  std::map<NodeName, std::set<std::string>> devices_;  ///< of the nodes that are there
  std::set<NodeName> asked_;                           ///< for birth certificates, a moment ago
  std::optional<Client> client_;                       ///< last, because its events use the other members
};

}  // namespace iotcloud::drivers::mqtt
