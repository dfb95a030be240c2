#pragma once

#include <cstdint>
#include <string>

namespace iotcloud::brokers {

/// The parts of a broker's URL, percent-decoded: scheme://user:password@host:port/path.
struct BrokerUrl {
  std::string scheme;      ///< lower case
  std::string user;        ///< empty: the URL has none
  std::string password;    ///< empty: the URL has none
  std::string host;        ///< for "embedded://NAME" the name; IPv6 without its brackets
  std::uint16_t port = 0;  ///< 0: the URL has none
  std::string path;        ///< without the leading slash: RabbitMQ's virtual host
  bool has_path = false;   ///< "amqp://host/" (an empty path) differs from "amqp://host" (none)
};

/// \throws config::Error that shows the URL without its password and says what is wrong.
BrokerUrl parse_broker_url(const std::string& url);

/// The port of the server: the URL's, or else the usual one of such a broker.
std::uint16_t server_port(const BrokerUrl& url);

}  // namespace iotcloud::brokers
