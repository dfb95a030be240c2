#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/config/thrift/tls.h>

namespace apache::thrift {
class TProcessor;
}

namespace iotcloud::config {

/// The other side of one connection, as what serves it sees it. Used by the connection's thread.
class ThriftPeer {
 public:
  ThriftPeer(std::string address, std::string certificate)
      : address_(std::move(address)), certificate_(std::move(certificate)) {}

  const std::string& address() const { return address_; }          ///< "192.0.2.7:40112"
  const std::string& certificate() const { return certificate_; }  ///< "CN=operator"; empty without TLS

  /// A call alone does not make it trusted: trust() does. Without this the first call that is answered does.
  void ask_who_it_is() { asked_ = true; }
  /// From now on its messages may be large, and it may be silent for as long as it likes.
  void trust() { trusted_ = true; }
  /// The connection is closed when the call under way is answered.
  void hang_up() { hung_up_ = true; }

  bool asked() const { return asked_; }
  bool trusted() const { return trusted_; }  ///< any thread
  bool hung_up() const { return hung_up_; }

 private:
  const std::string address_;
  const std::string certificate_;
  std::atomic<bool> trusted_{false};
  bool asked_ = false;
  bool hung_up_ = false;
};

/// Makes what answers one connection. Called on the connection's thread.
using ThriftService = std::function<std::shared_ptr<apache::thrift::TProcessor>(const std::shared_ptr<ThriftPeer>&)>;

struct ThriftServerOptions {
  std::string name = "thrift";  ///< says in metrics and logs which service it is
  std::string host = "127.0.0.1";
  int port = 0;  ///< 0: any free one, see ThriftServer::port()
  TlsFiles tls;  ///< when not empty: clients show a certificate of its authority
  /// One thread each. When there are so many, the one that has been a stranger for longest makes room; when there are
  /// no strangers, the new one is refused.
  int max_connections = 256;
  int max_message_bytes = 16 * 1024 * 1024;
  int max_items = 100'000;  ///< in one list or map
  /// Of those that are not trusted yet.
  int max_stranger_bytes = 64 * 1024;
  /// From connecting until one is trusted: so long may it say nothing.
  std::chrono::milliseconds stranger_limit{10'000};
  /// From the first byte of a message to the last, in each direction.
  std::chrono::milliseconds message_limit{30'000};
};

/// A Thrift server, framed and binary, one thread for each connection, with TLS 1.2+ or without. Nothing that a client
/// says or leaves unsaid takes more memory than a message's limit, a thread for longer than its limits, or the server
/// from others. What is refused is counted: iotcloud_thrift_refused_total{service, reason}. Thrift's own servers end
/// when a connection cannot be accepted, and know no deadline for a whole message.
class ThriftServer {
 public:
  /// Serves once the constructor returns. \throws Error when the address cannot be listened on, or for TLS's files.
  ThriftServer(const ThriftServerOptions& options, ThriftService service);
  /// Takes no more calls and waits for those under way; clients that only hold their connection open are cut off.
  ~ThriftServer();
  ThriftServer(const ThriftServer&) = delete;
  ThriftServer& operator=(const ThriftServer&) = delete;

  int port() const;
  /// Reads TLS's files again, for connections that come from now on. \throws Error that names the file that cannot be
  /// used, and then nothing changes. Any thread.
  void reload();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Counts one refusal in iotcloud_thrift_refused_total. \param service as ThriftServerOptions::name
void count_refusal(const std::string& service, const std::string& reason);

}  // namespace iotcloud::config
