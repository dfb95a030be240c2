#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/config/thrift/tls.h>

namespace apache::thrift::protocol {
class TProtocol;
}

namespace iotcloud::config {

struct ThriftClientOptions {
  std::string host;
  int port = 0;
  TlsFiles tls;  ///< when not empty: the server must prove to be `host`, and sees this certificate
  std::chrono::milliseconds connect_limit{3'000};  ///< until the connection is open, TLS included
  std::chrono::milliseconds answer_limit{30'000};  ///< from sending a call to the last byte of its answer
};

/// A connection to a Thrift service, framed and binary, for a generated client. Used by one thread.
class ThriftClient {
 public:
  /// Connects. \throws apache::thrift::transport::TTransportException that says why it cannot; Error for TLS's files.
  explicit ThriftClient(const ThriftClientOptions& options);
  ~ThriftClient();

  /// What a generated client is made from; it may outlive this.
  std::shared_ptr<apache::thrift::protocol::TProtocol> protocol() const;
  /// For the calls that follow.
  void set_answer_limit(std::chrono::milliseconds limit);

 private:
  class Transport;
  std::shared_ptr<Transport> transport_;
};

}  // namespace iotcloud::config
