#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include <thrift/TConfiguration.h>
#include <thrift/TProcessor.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

namespace iotcloud::fuzz {

/// What a server's thread does with the bytes of one connection, framed and binary, within the server's limits.
inline void serve(apache::thrift::TProcessorFactory& processors, const std::uint8_t* data, std::size_t size,
                  int max_bytes, int max_items) {
  using namespace apache::thrift;
  using transport::TFramedTransport;
  using transport::TMemoryBuffer;
  // The buffer is only read; its parameter is not const all the same.
  const auto received = std::make_shared<TMemoryBuffer>(const_cast<std::uint8_t*>(data),  // NOLINT
                                                        static_cast<std::uint32_t>(size), TMemoryBuffer::OBSERVE);
  const auto sent = std::make_shared<TMemoryBuffer>();
  const auto limits = std::make_shared<TConfiguration>(max_bytes, max_bytes);
  protocol::TBinaryProtocolFactory protocols(max_bytes, max_items, false, true);
  const auto in = protocols.getProtocol(std::make_shared<TFramedTransport>(received, limits));
  const auto out = protocols.getProtocol(std::make_shared<TFramedTransport>(sent, limits));
  const auto processor = processors.getProcessor({in, out, received});
  try {
    while (processor->process(in, out, nullptr)) {
    }
  } catch (const TException&) {  // NOLINT(bugprone-empty-catch): it closes the connection
  }
}

}  // namespace iotcloud::fuzz
