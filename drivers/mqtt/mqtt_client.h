#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/stream/address.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

struct mosquitto;
struct mosquitto_message;
struct mqtt5__property;  // NOLINT(bugprone-reserved-identifier): libmosquitto's name

namespace iotcloud::drivers::mqtt {

/// How to reach an MQTT broker.
struct ClientOptions {
  bool tls = false, five = false;
  std::string url, host;
  std::uint16_t port = 0;
  int keepalive_s = 30;
  std::uint32_t session_s = 3600;  ///< 0: the broker keeps nothing
  std::size_t most_bytes = 1 << 20;
  std::string client_id, user, password_file, ca, certificate, key;
  stream::ReconnectPauses pauses;

  /// \throws std::invalid_argument that names the property which is wrong
  static ClientOptions read(PropertyReader& reader);
};

/// The properties that ClientOptions::read() reads, for the declarations of drivers.
inline constexpr std::array client_properties{
    PropertySpec{.name = "url", .required = true, .text = "mqtt://HOST[:1883] or mqtts://HOST[:8883]"},
    PropertySpec{.name = "version", .default_value = "3.1.1", .choices = {"3.1.1", "5"}, .text = "of MQTT"},
    PropertySpec{.name = "client_id", .text = "the instance's id"},
    PropertySpec{.name = "session_s",
                 .type = PropertyType::integer,
                 .unit = "s",
                 .min = 0,
                 .max = 4'000'000,
                 .default_value = "3600",
                 .text = "how long the broker keeps messages while the driver is away; MQTT 3.1.1: as long as it "
                         "likes; 0: it keeps none"},
    PropertySpec{.name = "keepalive_s",
                 .type = PropertyType::integer,
                 .unit = "s",
                 .min = 5,
                 .max = 65'535,
                 .default_value = "30",
                 .text = "a connection on which nothing comes for this long is tried, and then ended"},
    PropertySpec{.name = "user", .text = "none"},
    PropertySpec{.name = "password_file", .text = "file whose first line is the password"},
    PropertySpec{.name = "ca", .text = "mqtts: file of the authority; the system's"},
    PropertySpec{.name = "certificate", .text = "mqtts: file of the client's certificate; none"},
    PropertySpec{.name = "key", .text = "mqtts: file of its key"},
    stream::most_bytes_property("of a message; a longer one is refused"),
    stream::reconnect_ms,
    stream::reconnect_most_ms,
};

/// Some properties, and then those of the client.
template <std::size_t Own>
constexpr auto with_client_properties(const std::array<PropertySpec, Own>& own) {
  std::array<PropertySpec, Own + client_properties.size()> all{};
  for (std::size_t i = 0; i < client_properties.size(); ++i) all[i] = client_properties[i];
  for (std::size_t i = 0; i < Own; ++i) all[client_properties.size() + i] = own[i];
  return all;
}

/// What a message of an MQTT broker needs to be published.
struct Outgoing {
  std::string topic;
  std::string_view payload;
  int qos = 1;
  bool retain = false;
  PropertyMap user_properties{};  ///< MQTT 5 only
};

/// A connection to an MQTT broker by libmosquitto, made anew when it ends. Says in the instance's metadata whether the
/// broker is there. All calls and events are on the instance's event thread; its first connection waits for names, so
/// the driver asks for a thread of its own.
class Client {
 public:
  struct Events {
    std::function<void()> on_connected;
    /// A message that is no longer than ClientOptions::most_bytes.
    std::function<void(const mosquitto_message& message, const mqtt5__property* properties)> on_message;
    /// The connection has ended, or could not be made. May be empty.
    std::function<void(const std::string& reason)> on_away{};
    /// The broker has confirmed what publish() gave this number. May be empty.
    std::function<void(int number)> on_sent{};
    /// After every step that may have brought messages. May be empty.
    std::function<void()> after_step{};
    /// Whether more may be read from the broker; empty: always.
    std::function<bool()> may_read{};
  };
  Client(DriverContext& context, ClientOptions options, Events events);
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  void connect();
  bool connected() const { return connected_; }
  const ClientOptions& options() const { return options_; }
  void subscribe(const std::string& filter, int qos);
  /// \param number of the message for Events::on_sent; 0: it has been sent already
  /// \return why it cannot be published; empty: it is
  std::string publish(const Outgoing& message, int& number);
  std::string publish(const Outgoing& message) {
    int number = 0;
    return publish(message, number);
  }
  /// Events::may_read or something to be written may have changed.
  void refresh();

 private:
  void make();
  void start_session();
  void connection_answered(int code);
  void subscribed(int filters, const int* granted);
  void received(const mosquitto_message& message, const mqtt5__property* properties);
  void away(const std::string& reason);
  void after_call(int status);
  void watch();
  void unwatch();
  bool may_read() const { return !events_.may_read || events_.may_read(); }

  DriverContext& context_;
  const ClientOptions options_;
  const Events events_;
  stream::RareLog refused_;
  stream::Dialer dialer_;
  stream::Retry retry_;
  std::optional<stream::DeviceState> state_;
  mosquitto* client_ = nullptr;
  bool connected_ = false;  ///< the broker has taken the session
  bool waits_ = false;      ///< the connection is made anew when more may be read
  std::string refusal_;     ///< why the broker does not take the session
  int last_sent_ = 0;       ///< the library's number of what was sent, or confirmed, last
  std::optional<HandlerId> readable_, writable_, misc_, limit_;
};

}  // namespace iotcloud::drivers::mqtt
