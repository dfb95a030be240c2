#pragma once

#include <array>
#include <chrono>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/modbus/register_map.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

struct _modbus;  // NOLINT(bugprone-reserved-identifier): libmodbus' name

namespace iotcloud::drivers::modbus {

/// A Modbus device whose registers are polled: README.md. It has an event thread of its own, because libmodbus waits
/// for answers.
class ModbusDriver : public Driver {
 public:
  static constexpr std::string_view readings_channel = "readings", write_channel = "write";
  static constexpr std::string_view description =
      "A Modbus device: its registers, by a map, as JSON on readings; values to write on write";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "connect", .text = "HOST[:502] of a device that speaks Modbus TCP; this or device"},
      PropertySpec{.name = "device", .text = "serial line of devices that speak Modbus RTU, such as /dev/ttyUSB0"},
      PropertySpec{.name = "baud",
                   .type = PropertyType::integer,
                   .min = 300,
                   .max = 4'000'000,
                   .default_value = "19200",
                   .text = "device: bits a second"},
      PropertySpec{.name = "parity", .default_value = "even", .choices = {"none", "even", "odd"}, .text = "device"},
      PropertySpec{.name = "stop_bits", .default_value = "1", .choices = {"1", "2"}, .text = "device"},
      PropertySpec{.name = "unit",
                   .type = PropertyType::integer,
                   .min = 0,
                   .max = 255,
                   .default_value = "1",
                   .text = "the device's number, on a line or behind a TCP gateway"},
      PropertySpec{.name = "registers", .text = "the map, in YAML; this or registers_file"},
      PropertySpec{.name = "registers_file", .text = "file with the map"},
      PropertySpec{.name = "period_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 10,
                   .max = 86'400'000,
                   .default_value = "1000",
                   .text = "from one poll to the next"},
      PropertySpec{.name = "timeout_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 10,
                   .max = 5'000,
                   .default_value = "500",
                   .text = "longest time until the device answers"},
      PropertySpec{.name = "report",
                   .default_value = "all",
                   .choices = {"all", "changes"},
                   .text = "a message for each poll, or for those that differ from the last"},
      stream::reconnect_ms,
      stream::reconnect_most_ms,
      stream::broker_property,
  };

  ~ModbusDriver() override;
  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  struct Options {
    std::string host, port, device, broker;
    int baud = 19'200, stop_bits = 1, unit = 1;
    char parity = 'E';
    std::chrono::milliseconds period{1000}, timeout{500};
    stream::ReconnectPauses pauses;
    bool only_changes = false;
    std::vector<Register> map;
  };
  static Options read_options(const PropertyMap& properties);
  void connect();
  void disconnect();
  void away(const std::string& reason);
  void poll();
  /// Reads a group into values_; of a group that the device refuses each register alone.
  /// \return why the device is away; empty: it answers
  std::string read(const Group& group);
  /// \return 0, or the library's error
  int request(Table table, int first, int count);
  void publish(const std::string& json);
  std::string write(const std::string& json);
  std::string write(const Register& reg, double value);

  DriverContext* context_ = nullptr;
  Options options_;
  std::vector<Group> groups_;
  std::optional<stream::DeviceState> state_;
  std::optional<stream::Retry> retry_;
  std::optional<stream::RareLog> lost_;
  _modbus* device_ = nullptr;
  std::optional<HandlerId> timer_;
  std::vector<std::uint16_t> words_;        ///< what the last request read
  std::map<std::size_t, Value> values_;     ///< of this poll, by their places in the map
  std::set<std::size_t> refused_;           ///< registers that the device refuses to read
  std::string last_;                        ///< what was published last
  std::optional<std::string> unpublished_;  ///< the channel is full
};

}  // namespace iotcloud::drivers::modbus
