#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/security/tls.h>

namespace apache::thrift {
class TException;
}
namespace apache::thrift::protocol {
class TProtocol;
}

namespace iotcloud::rpc {

/// Which service a client calls, and how long it waits.
struct ThriftClientOptions {
  std::string host;
  int port = 0;
  /// if not empty, the server must prove that it is `host`, and this client shows the certificate
  security::TlsFiles tls;
  /// with TLS: the server's certificate must also be that of this daemon; nullopt: any
  std::optional<security::NamedDaemon> daemon;
  std::chrono::milliseconds connect_limit{3'000};  ///< until the connection is open, TLS included
  std::chrono::milliseconds answer_limit{30'000};  ///< from the start of a call to the last byte of its answer
  int most_bytes = 64 << 20;                       ///< in an answer; a larger one is not read
};

/// A connection to a Thrift service, framed and binary, for a generated client. Used by one thread.
class ThriftClient {
 public:
  /// Connects. \throws apache::thrift::transport::TTransportException with the reason; Error for unusable TLS files.
  explicit ThriftClient(const ThriftClientOptions& options);
  ~ThriftClient();

  /// The protocol for a generated client; it may outlive this object.
  std::shared_ptr<apache::thrift::protocol::TProtocol> protocol() const;
  /// Whether a call failed because its answer is larger than `most_bytes`, or says so.
  static bool is_too_large(const apache::thrift::TException& error);
  /// Sets the limit of later calls.
  void set_answer_limit(std::chrono::milliseconds limit);

 private:
  class Transport;
  const int most_bytes_;
  std::shared_ptr<Transport> transport_;
};

}  // namespace iotcloud::rpc
