#include "iotcloud/brokers/rabbitmq/wire/acknowledged_bytes.h"

#include <cstddef>

#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/socket.h>

namespace iotcloud::brokers::rabbitmq {

std::optional<std::uint64_t> acknowledged_bytes(int descriptor) noexcept {
  tcp_info info{};
  socklen_t length = sizeof(info);
  if (::getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &length) != 0) return std::nullopt;
  if (length <= offsetof(tcp_info, tcpi_bytes_acked)) return std::nullopt;
  return info.tcpi_bytes_acked;
}

}  // namespace iotcloud::brokers::rabbitmq
