#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <sys/types.h>

#include <iotcloud/security/tls.h>
#include <iotcloud/security/tokens.h>

namespace apache::thrift {
class TProcessor;
}

namespace iotcloud::rpc {

/// The client at the other end of one connection. Used by the connection's thread.
class ThriftPeer {
 public:
  ThriftPeer(std::string address, std::string certificate)
      : address_(std::move(address)), certificate_(std::move(certificate)), identity_(host_of(address_)) {}

  const std::string& address() const { return address_; }          ///< "192.0.2.7:40112"
  const std::string& certificate() const { return certificate_; }  ///< "CN=operator"; empty without TLS

  /// From now on only trust() makes the peer trusted. Without this call, its first answered call makes it trusted.
  void ask_who_it_is() { asked_ = true; }
  /// From now on the peer may send messages of this size, and be silent for as long as ThriftServerOptions::idle_limit.
  void trust(int most_bytes = std::numeric_limits<int>::max()) {
    most_bytes_ = most_bytes;
    trusted_ = true;
  }
  /// Sets who the peer is: connections of one identity share their limits. Before this call the identity is the host of
  /// its address.
  void set_identity(std::string identity) {
    identity_ = std::move(identity);
    named_ = true;
  }
  /// Who calls, of whom this process has seen a token that counts: a session (session.h) takes it as shown. For a peer
  /// without a connection, for whom this process calls its own service, such as a person at the console.
  void vouch(security::TokenEntry holder) { vouched_ = std::move(holder); }
  const std::optional<security::TokenEntry>& vouched() const { return vouched_; }
  /// Asked now and then, on any thread, whether the peer may keep its connection.
  void set_validity(std::function<bool()> is_valid) { is_valid_ = std::move(is_valid); }
  std::function<bool()> take_validity() { return std::exchange(is_valid_, {}); }
  /// Keeps an object until the answer of the current call was sent.
  void hold(std::shared_ptr<void> object) { held_ = std::move(object); }
  void release() { held_.reset(); }
  /// The connection is closed after the answer of the current call.
  void hang_up() { hung_up_ = true; }

  bool asked() const { return asked_; }
  bool trusted() const { return trusted_; }  ///< any thread
  bool hung_up() const { return hung_up_; }
  int most_bytes() const { return most_bytes_; }  ///< in a message, once it is trusted
  const std::string& identity() const { return identity_; }
  /// The user of this machine whose process it is; nullopt: it is elsewhere, or not known (peer_user.h).
  std::optional<uid_t> user() const { return user_; }
  void set_user(std::optional<uid_t> user) { user_ = user; }
  bool named() const { return named_; }  ///< set_identity() was called

 private:
  static std::string host_of(const std::string& address) { return address.substr(0, address.rfind(':')); }

  const std::string address_;
  const std::string certificate_;
  std::string identity_;
  std::optional<uid_t> user_;
  std::optional<security::TokenEntry> vouched_;
  std::shared_ptr<void> held_;
  std::function<bool()> is_valid_;
  std::atomic<bool> trusted_{false};
  int most_bytes_ = std::numeric_limits<int>::max();
  bool named_ = false;
  bool asked_ = false;
  bool hung_up_ = false;
};

/// Makes the handler of one connection. Called on the connection's thread.
using ThriftService = std::function<std::shared_ptr<apache::thrift::TProcessor>(const std::shared_ptr<ThriftPeer>&)>;

/// Where a server listens, and the limits of its clients.
struct ThriftServerOptions {
  std::string name = "thrift";  ///< names the service in metrics and logs
  std::string host = "127.0.0.1";
  int port = 0;            ///< 0: any free port, see ThriftServer::port()
  security::TlsFiles tls;  ///< if not empty, clients must show a certificate of its authority
  /// Each connection has a thread. At the limit the oldest stranger loses its connection; without strangers the one
  /// that has been idle the longest, of the identity that has the most. A connection whose call is under way loses
  /// nothing: when all are at that, the new one is refused.
  int max_connections = 256;
  /// The most connections of one identity that named itself (by a token). When there are more, the server closes the
  /// one that has been idle the longest.
  int max_connections_of_one = 64;
  int max_message_bytes = 16 * 1024 * 1024;
  int max_items = 100'000;  ///< most items in one list or map
  /// Limit for clients that are not trusted yet.
  int max_stranger_bytes = 64 * 1024;
  /// Longest time from connecting until the client is trusted.
  std::chrono::milliseconds stranger_limit{10'000};
  /// Longest time for which a trusted client sends nothing.
  std::chrono::milliseconds idle_limit{3'600'000};
  /// How often it looks whether the TLS files have changed, and whether certificates and tokens of open connections are
  /// still good.
  std::chrono::milliseconds look_period{5'000};
  /// Longest time from the first byte of a message to the last, in each direction.
  std::chrono::milliseconds message_limit{30'000};
};

/// A Thrift server, framed and binary, one thread for each connection, with or without TLS 1.2+. Whatever a client
/// sends or does not send, it cannot take more memory than the message limit, hold a thread beyond its time limits, or
/// keep others from the server. Refusals are counted: iotcloud_thrift_refused_total{service, reason}; of each reason
/// one a minute is logged. Reason for not using Thrift's own servers: they stop when a connection cannot be accepted,
/// and have no deadline for a whole message.
class ThriftServer {
 public:
  /// Serves once the constructor returns. \throws Error if it cannot listen on the address, or for unusable TLS files.
  ThriftServer(const ThriftServerOptions& options, ThriftService service);
  /// Takes no more calls and waits for those in progress; idle connections are closed.
  ~ThriftServer();
  ThriftServer(const ThriftServer&) = delete;
  ThriftServer& operator=(const ThriftServer&) = delete;

  int port() const;
  /// Reads the TLS files again, for later connections, and closes open ones whose certificate was revoked or whose
  /// token was taken away. The server does both by itself within `look_period`. \throws Error that names the unusable
  /// file; then nothing changes. Any thread.
  void reload();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Counts one refusal in iotcloud_thrift_refused_total. \param service as in ThriftServerOptions::name
void count_refusal(const std::string& service, const std::string& reason);

}  // namespace iotcloud::rpc
