#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>

#include <sys/types.h>

namespace iotcloud::security {
class TlsContext;
struct NamedDaemon;
struct ShownCertificate;
}  // namespace iotcloud::security

namespace iotcloud::rpc {

/// Why a connection ended.
class TcpStreamError : public std::runtime_error {
 public:
  enum class Kind {
    ended,      ///< the other side closed it
    timed_out,  ///< the deadline passed
    tls,        ///< one side does not trust the other's certificate, or the other side lacks TLS 1.2
    broken,     ///< the network failed, or cut() was called
  };
  TcpStreamError(Kind kind, const std::string& text) : std::runtime_error(text), kind_(kind) {}
  Kind kind() const { return kind_; }

 private:
  Kind kind_;
};

/// A TCP connection whose every wait has a deadline, with or without TLS. A peer that sends byte by byte does not
/// prolong a deadline. One thread uses it, but any thread may call cut() and cut_reading(). Never raises SIGPIPE.
class TcpStream {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::time_point never = Clock::time_point::max();

  /// Owns the connected socket from now on. `tls` must outlive it; nullptr: no TLS. Sends nothing yet.
  TcpStream(int descriptor, const security::TlsContext* tls);
  /// Closes the connection. With TLS it sends close_notify, but does not wait for the peer's.
  ~TcpStream();
  TcpStream(const TcpStream&) = delete;
  TcpStream& operator=(const TcpStream&) = delete;

  /// Connects within the deadline; with TLS the server must prove that it is `host`. \throws TcpStreamError
  static std::unique_ptr<TcpStream> connect(const std::string& host, int port, const security::TlsContext* tls,
                                            Clock::time_point deadline);
  /// The server's side of the TLS handshake; without TLS it does nothing. \throws TcpStreamError
  void accept(Clock::time_point deadline);

  /// \return from 1 to `size` bytes. \throws TcpStreamError
  std::size_t read_some(void* to, std::size_t size, Clock::time_point deadline);
  /// \throws TcpStreamError
  void write_all(const void* from, std::size_t size, Clock::time_point deadline);

  /// Ends every current and later operation of this connection with an error. Any thread.
  void cut();
  /// Ends all reading; an answer can still be written. Any thread.
  void cut_reading();

  /// The other side's certificate; none without TLS.
  security::ShownCertificate shown_certificate() const;
  /// As peer_user.h says.
  std::optional<uid_t> peer_user() const;
  std::string peer_address() const;  ///< "192.0.2.7:40112"
  /// The subject of the other side's certificate, "CN=operator"; empty if it showed none.
  std::string peer_certificate() const;
  /// security::is_peer(); false without TLS.
  bool is_peer(const security::NamedDaemon& daemon) const;

 private:
  struct Tls;
  void begin_tls(const security::TlsContext& context);
  void shake_hands(Clock::time_point deadline);
  void wait(short events, Clock::time_point deadline) const;
  /// Waits until an OpenSSL call that returned `result` can be repeated. \throws TcpStreamError
  void after_tls(int result, Clock::time_point deadline);

  const int descriptor_;
  const security::TlsContext* const context_;
  std::unique_ptr<Tls> tls_;  ///< null before the handshake and without TLS
};

}  // namespace iotcloud::rpc
