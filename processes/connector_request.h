#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include <sys/socket.h>

namespace iotcloud::processes {

// What a confined process asks the one that makes its connections for (connector.h): a message of bytes, with a socket
// for the answer.

/// To connect a socket, which comes as a second descriptor.
struct ConnectRequest {
  sockaddr_storage address{};
  socklen_t size = 0;
};

/// To find the addresses of a machine.
struct FindRequest {
  std::string name;
  bool configured = false;  ///< those of kinds that this machine has are enough
};

using ConnectorRequest = std::variant<ConnectRequest, FindRequest>;

inline constexpr std::size_t longest_connector_request = 2048;

std::string encode(const ConnectorRequest& request);
/// \param descriptors how many came with the bytes. \return nullopt: these are no request.
std::optional<ConnectorRequest> decode_connector_request(std::string_view bytes, std::size_t descriptors);

}  // namespace iotcloud::processes
