#pragma once

#include <array>
#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include <iotcloud/drivers/stream/address.h>
#include <iotcloud/drivers/stream/stream_driver.h>

namespace iotcloud::drivers::tcp {

/// Devices that speak TCP: one that the driver connects to, or those that connect to it. README.md.
class TcpDriver : public stream::ConnectingDriver {
 public:
  static constexpr std::string_view description =
      "A device that speaks TCP, as client or server: its frames on received, commands to it on send";
  static constexpr auto declared_properties = stream::joined(
      stream::joined(
          std::array{
              PropertySpec{.name = "connect", .text = "HOST:PORT of the device; this or listen"},
              PropertySpec{.name = "listen", .text = "ADDRESS:PORT to which devices connect; port 0: any"},
              PropertySpec{.name = "peers",
                           .type = PropertyType::integer,
                           .min = 1,
                           .max = 10'000,
                           .default_value = "16",
                           .text = "listen: most devices that are connected at a time"},
              PropertySpec{.name = "silence_ms",
                           .type = PropertyType::integer,
                           .unit = "ms",
                           .min = 0,
                           .max = 86'400'000,
                           .default_value = "0",
                           .text = "a connection on which nothing comes for this long is ended; 0: none"},
          },
          stream::stream_properties("delimiter")),
      stream::connecting_properties);

  void open(DriverContext& context) override;
  void close() override;

 protected:
  void read(PropertyReader& reader) override;
  void connect() override;
  std::string send(const std::string& bytes, const Message& message) override;
  void resume() override;

 private:
  void listen();
  void watch_listener();
  void accept();
  void tell_peers();

  std::string connect_text_, listen_text_;
  stream::HostPort peer_;
  stream::Address listen_;
  std::size_t most_peers_ = 16;
  std::chrono::milliseconds silence_{0};
  std::optional<stream::Dialer> dialer_;
  int listener_ = -1;
  std::optional<HandlerId> acceptable_;
  std::optional<stream::RareLog> turned_away_;
  std::map<std::string, std::unique_ptr<stream::FrameLink>> guests_;  ///< by their addresses
};

}  // namespace iotcloud::drivers::tcp
