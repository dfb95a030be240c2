#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::can {

/// Frames whose id has the bits of `id` where `mask` has ones.
struct Filter {
  std::uint32_t id = 0, mask = 0;
  bool extended = false;  ///< ids of 29 bits, not of 11
  friend bool operator==(const Filter&, const Filter&) = default;
};

/// Reads "ID[:MASK], ..." in hexadecimal; an id of more than three digits is an extended one.
/// \throws std::invalid_argument that says which is wrong
std::vector<Filter> read_filters(const std::string& text);

/// A CAN bus by SocketCAN: README.md.
class CanDriver : public Driver {
 public:
  static constexpr std::string_view received_channel = "received", send_channel = "send";
  static constexpr std::string_view id_property = "id", extended_property = "extended", remote_property = "remote",
                                    fd_property = "fd";
  static constexpr std::string_view description = "A CAN bus by SocketCAN: frames on received, frames to it on send";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "interface", .required = true, .text = "such as can0"},
      PropertySpec{.name = "filters", .text = "ID[:MASK], ... in hexadecimal: which frames come; all"},
      PropertySpec{.name = "send_id", .text = "id, in hexadecimal, of messages on send that have no property id"},
      PropertySpec{
          .name = "fd", .type = PropertyType::flag, .default_value = "false", .text = "CAN FD: up to 64 bytes"},
      stream::broker_property,
  };

  /// What the socket is to be.
  struct Socket {
    std::string interface;
    std::vector<Filter> filters;
    bool fd = false;
  };
  /// Opens a socket that never blocks, and reads and writes frames as the kernel's header can.h has them.
  /// \throws std::runtime_error when it cannot
  using Opener = std::function<int(const Socket&)>;

  explicit CanDriver(Opener opener = &open_socket) : opener_(std::move(opener)) {}
  /// SocketCAN of the kernel.
  static int open_socket(const Socket& wanted);

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  void connect();
  void away(const std::string& reason);
  void watch();
  void read();
  /// \return false: the channel is full
  bool publish(const Message& message);
  std::string send(const Message& message);

  const Opener opener_;
  DriverContext* context_ = nullptr;
  Socket wanted_;
  std::string broker_, send_id_;
  std::optional<stream::DeviceState> state_;
  std::optional<stream::Retry> retry_;
  std::optional<stream::RareLog> lost_, errors_;
  int socket_ = -1;
  bool active_ = false;
  std::optional<HandlerId> readable_;
  std::optional<Message> unpublished_;  ///< the channel is full
};

}  // namespace iotcloud::drivers::can
