#pragma once

#include <cstdint>
#include <optional>

namespace iotcloud::brokers::rabbitmq {

/// How many bytes the other side of a TCP connection has acknowledged since it was opened (tcp_info, Linux 4.1 and
/// later). Nothing if the kernel does not tell, or `descriptor` is not a TCP socket.
std::optional<std::uint64_t> acknowledged_bytes(int descriptor) noexcept;

}  // namespace iotcloud::brokers::rabbitmq
