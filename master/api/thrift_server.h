#pragma once

#include <memory>
#include <string>

namespace apache::thrift {
class TProcessorFactory;
}

namespace iotcloud::master {

struct ThriftServerOptions {
  std::string host = "127.0.0.1";
  int port = 0;  ///< 0: any free one, see ThriftServer::port()
  /// One thread each; further clients wait in the listen queue.
  int max_connections = 256;
  /// Larger messages close the connection: nothing a client says makes the server take more memory for it.
  int max_message_bytes = 16 * 1024 * 1024;
  int max_items = 100'000;  ///< in one list or map
};

/// True for what only this machine reaches: 127.0.0.0/8, ::1, localhost.
bool is_loopback(const std::string& host);

/// A Thrift server, framed and binary, one thread for each connection.
class ThriftServer {
 public:
  /// Serves once the constructor returns. \param processors makes one for each connection.
  /// \throws config::Error when the address cannot be listened on.
  ThriftServer(const ThriftServerOptions& options, std::shared_ptr<apache::thrift::TProcessorFactory> processors);
  /// Takes no more calls and waits for those under way; clients that only hold their connection open are cut off.
  ~ThriftServer();
  ThriftServer(const ThriftServer&) = delete;
  ThriftServer& operator=(const ThriftServer&) = delete;

  int port() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
