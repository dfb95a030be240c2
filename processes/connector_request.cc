#include <cstring>

#include <iotcloud/processes/connector_request.h>

namespace iotcloud::processes {

namespace {

// The first letter of a request. To connect, the address's bytes follow; to find a machine, '1' or '0' for `configured`
// and the name.
constexpr char to_connect = 'c', to_find = 'f';

}  // namespace

std::string encode(const ConnectorRequest& request) {
  if (const auto* to = std::get_if<ConnectRequest>(&request)) {
    std::string bytes(1, to_connect);
    return bytes.append(reinterpret_cast<const char*>(&to->address), to->size);
  }
  const auto& wanted = std::get<FindRequest>(request);
  return std::string(1, to_find) + (wanted.configured ? '1' : '0') + wanted.name;
}

std::optional<ConnectorRequest> decode_connector_request(std::string_view bytes, std::size_t descriptors) {
  if (bytes.empty() || descriptors == 0) return std::nullopt;
  const std::string_view rest = bytes.substr(1);
  if (bytes.front() == to_find && rest.size() > 1) return FindRequest{std::string(rest.substr(1)), rest.front() == '1'};
  const bool is_address = rest.size() >= sizeof(sa_family_t) && rest.size() <= sizeof(sockaddr_storage);
  if (bytes.front() != to_connect || descriptors != 2 || !is_address) return std::nullopt;
  ConnectRequest request;
  std::memcpy(&request.address, rest.data(), rest.size());
  request.size = static_cast<socklen_t>(rest.size());
  return request;
}

}  // namespace iotcloud::processes
