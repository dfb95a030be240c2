#pragma once

#include <array>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include <iotcloud/drivers/stream/address.h>
#include <iotcloud/drivers/stream/stream_driver.h>

namespace iotcloud::drivers::udp {

/// Devices that send and take datagrams: README.md.
class UdpDriver : public stream::StreamDriver {
 public:
  static constexpr std::string_view description =
      "Devices that send datagrams: their frames on received, commands to them on send";
  static constexpr auto declared_properties = stream::joined(
      std::array{
          PropertySpec{.name = "listen", .text = "ADDRESS:PORT at which datagrams come; port 0: any"},
          PropertySpec{.name = "send_to", .text = "HOST:PORT of the device to which commands go"},
          PropertySpec{.name = "multicast", .text = "address of a group whose datagrams come, too"},
      },
      stream::stream_properties("none"));

  void open(DriverContext& context) override;
  void close() override;

 protected:
  void read(PropertyReader& reader) override;
  void connect() override;
  std::string send(const std::string& bytes, const Message& message) override;
  void resume() override;

 private:
  void open_socket(const stream::Address& address);
  /// \return why it cannot; empty: it has joined
  std::string join() const;
  void receive();
  bool hand_over();
  void watch();

  std::string listen_text_, send_to_text_, multicast_;
  stream::Address listen_;
  stream::HostPort peer_;
  std::optional<stream::Resolver> resolver_;
  std::optional<stream::Retry> retry_;
  std::optional<stream::RareLog> dropped_, refused_;
  std::optional<stream::Address> device_;  ///< to which commands go
  int socket_ = -1;
  std::optional<HandlerId> readable_;
  std::uint32_t dropped_before_ = 0;  ///< datagrams for which the kernel had no room, as it counts them
  std::deque<std::pair<Payload, std::string>>
      frames_;  ///< of one datagram, with its sender, that could not be taken yet
};

}  // namespace iotcloud::drivers::udp
