#pragma once

#include <array>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/mqtt/mqtt_client.h>
#include <iotcloud/drivers/mqtt/sparkplug/sparkplug.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::mqtt::sparkplug {

/// An edge node of Sparkplug B, or one of its devices: README.md.
class SparkplugDriver : public Driver {
 public:
  static constexpr std::string_view metrics_channel = "metrics", commands_channel = "commands";
  static constexpr std::string_view metric_property = "metric";
  static constexpr std::string_view description =
      "Metrics of an edge node of Sparkplug B, or of one of its devices, as JSON; commands write them";
  static constexpr auto declared_properties = with_client_properties(std::array{
      PropertySpec{.name = "group", .required = true, .text = "Sparkplug's group"},
      PropertySpec{.name = "node", .required = true, .text = "edge node"},
      PropertySpec{.name = "device", .text = "one of its devices; the node itself"},
      stream::broker_property,
  });

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void close() override { client_.reset(); }
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  struct Options {
    ClientOptions client;
    std::string group, node, device, broker;
  };
  static Options read_options(const PropertyMap& properties);
  void connected();
  void received(std::string_view topic, std::string_view payload);
  void ask_for_births();
  void drain();
  std::string write(const Message& message);

  DriverContext* context_ = nullptr;
  Options options_;
  std::optional<stream::RareLog> lost_, refused_;
  Node known_;
  bool active_ = false;
  bool full_ = false;
  bool asked_ = false;  ///< for birth certificates, a moment ago
  std::deque<Message> pending_;
  std::optional<Client> client_;  ///< last, because its events use the other members
};

/// The JSON of a message: {"kind", "group", "node", "device", "timestamp", "metrics": [...]}. Metrics without a name
/// are left out.
std::string json_of(const Topic& topic, const Payload& payload);

}  // namespace iotcloud::drivers::mqtt::sparkplug
