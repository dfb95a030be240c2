#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include <thrift/TProcessor.h>

#include "iotcloud/rpc/connection.h"
#include "iotcloud/rpc/thrift_server.h"

namespace iotcloud::fuzz {

/// Handles the bytes of one connection as a server does after it has accepted the client, within the server's limits.
inline void serve(const rpc::ThriftService& service, const std::uint8_t* data, std::size_t size,
                  const rpc::ThriftServerOptions& limits) {
  constexpr std::size_t head = 4;  // the length of a message, the high byte first
  const auto peer = std::make_shared<rpc::ThriftPeer>("127.0.0.1:1", "");
  peer->set_user(0);  // who may call every method
  const auto processor = service(peer);
  std::string_view left(reinterpret_cast<const char*>(data), size);
  try {
    while (left.size() >= head) {
      std::size_t length = 0;
      for (std::size_t i = 0; i < head; ++i) length = length << 8 | static_cast<unsigned char>(left[i]);
      left.remove_prefix(head);
      if (length > static_cast<std::size_t>(limits.max_message_bytes) || length > left.size()) return;
      std::string answer;
      if (!rpc::answer_message(*processor, std::string(left.substr(0, length)), limits.max_items, answer)) return;
      left.remove_prefix(length);
    }
  } catch (const apache::thrift::TException&) {  // NOLINT(bugprone-empty-catch): the server would close the connection
  }
}

}  // namespace iotcloud::fuzz
