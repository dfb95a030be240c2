#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>

namespace iotcloud::config {

class TlsContext;

/// Why a connection cannot go on.
class StreamError : public std::runtime_error {
 public:
  enum class Kind {
    ended,      ///< the other side closed it
    timed_out,  ///< the deadline passed
    tls,        ///< the other side is not trusted, does not trust this one, or speaks no TLS 1.2
    broken,     ///< the network, or cut()
  };
  StreamError(Kind kind, const std::string& text) : std::runtime_error(text), kind_(kind) {}
  Kind kind() const { return kind_; }

 private:
  Kind kind_;
};

/// A TCP connection whose every wait has a deadline, with TLS or without. What the other side sends byte by byte does
/// not prolong a deadline. Used by one thread, except cut() and cut_reading(). Never raises SIGPIPE.
class Stream {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::time_point never = Clock::time_point::max();

  /// Takes the connected socket over. `tls` outlives it; nullptr: as it is. Nothing is sent yet.
  Stream(int descriptor, const TlsContext* tls);
  /// Closes it. With TLS the other side is told, but not waited for.
  ~Stream();
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  /// Connects within the deadline, with TLS up to a server that proved to be `host`. \throws StreamError
  static std::unique_ptr<Stream> connect(const std::string& host, int port, const TlsContext* tls,
                                         Clock::time_point deadline);
  /// The server's side of opening a connection with TLS; without TLS nothing. \throws StreamError
  void accept(Clock::time_point deadline);

  /// \return from 1 to `size` bytes. \throws StreamError
  std::size_t read_some(void* to, std::size_t size, Clock::time_point deadline);
  /// \throws StreamError
  void write_all(const void* from, std::size_t size, Clock::time_point deadline);

  /// Ends what waits in this connection, and all that comes after it. Any thread.
  void cut();
  /// Ends waiting for what the other side sends; an answer can still be written. Any thread.
  void cut_reading();

  std::string peer_address() const;  ///< "192.0.2.7:40112"
  /// The subject of the other side's certificate, "CN=operator"; empty: it has shown none.
  std::string peer_certificate() const;

 private:
  struct Tls;
  void begin_tls(const TlsContext& context);
  void shake_hands(Clock::time_point deadline);
  void wait(short events, Clock::time_point deadline) const;
  /// What a call of OpenSSL that returned `result` needs before it is tried again; waits for it. \throws StreamError
  void after_tls(int result, Clock::time_point deadline);

  const int descriptor_;
  const TlsContext* const context_;
  std::unique_ptr<Tls> tls_;  ///< null before the handshake and without TLS
};

}  // namespace iotcloud::config
