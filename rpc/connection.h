#pragma once

#include <atomic>
#include <memory>
#include <string>

#include <iotcloud/config/mutex.h>
#include <iotcloud/rpc/refusal_log.h>
#include <iotcloud/rpc/tcp_stream.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

/// Answers one message. \param answer gets the answer after its length; unchanged if there is no answer.
/// \return false if the message was not a call. \throws apache::thrift::TException if it cannot be read.
bool answer_message(apache::thrift::TProcessor& processor, const std::string& message, int max_items,
                    std::string& answer);

/// One client's connection to a ThriftServer. Private to the server's sources.
class ThriftConnection {
 public:
  /// \param tls null: no TLS
  ThriftConnection(const ThriftServerOptions& options, const ThriftService& service,
                   std::shared_ptr<const security::TlsContext> tls, int descriptor, RefusalLog& log);

  /// Answers messages until the client disconnects, breaks a limit, or the server stops. Never throws.
  void serve() noexcept;
  /// Reads no more messages; the answer of the current call is still sent. Any thread.
  void stop();
  /// Ends the connection at once. Any thread.
  void cut() { stream_.cut(); }
  bool is_stranger() const { return !trusted_; }

  /// The connection's user, and since when it waits for its next message. Any thread.
  struct Standing {
    std::string identity;
    bool named = false;      ///< the identity is more than an address
    bool answering = false;  ///< a call is under way
    TcpStream::Clock::time_point since;
  };
  Standing standing() const IOTCLOUD_EXCLUDES(mutex_);
  /// Why the client may not keep this connection: its certificate is not trusted any more, its token was taken away.
  /// Empty: it may. Any thread. \param tls the present one; null: none
  std::string distrust(const security::TlsContext* tls) const IOTCLOUD_EXCLUDES(mutex_);
  const std::string& address() const { return address_; }

 private:
  using TimePoint = TcpStream::Clock::time_point;
  void open();
  /// \return the next message, without its length. \throws TcpStreamError, Refused
  std::string read_message();
  void answer(const std::string& message);
  void note_standing(bool answering) IOTCLOUD_EXCLUDES(mutex_);
  void refuse(const std::string& reason, const std::string& text);

  const ThriftServerOptions& options_;
  const ThriftService& service_;
  const std::shared_ptr<const security::TlsContext> tls_;
  RefusalLog& log_;
  const TimePoint stranger_until_;
  TcpStream stream_;
  const std::string address_;
  std::shared_ptr<ThriftPeer> peer_;
  std::shared_ptr<apache::thrift::TProcessor> processor_;
  mutable config::Mutex mutex_;
  Standing standing_ IOTCLOUD_GUARDED_BY(mutex_);
  security::ShownCertificate certificate_ IOTCLOUD_GUARDED_BY(mutex_);
  std::function<bool()> is_valid_ IOTCLOUD_GUARDED_BY(mutex_);
  std::atomic<bool> trusted_{false};
  std::atomic<bool> stopping_{false};
};

}  // namespace iotcloud::rpc
