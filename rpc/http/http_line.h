#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>

#include <boost/asio/buffer.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/system/error_code.hpp>

struct ssl_ctx_st;
struct ssl_st;

namespace iotcloud::rpc {

/// What HTTP is spoken over: TCP, with TLS or without. All handlers have one type, so that Asio's operations, which are
/// templates, are compiled once and not for each step of each kind of connection. Used by the thread that runs the
/// socket's context; operations keep nothing alive, so a handler must own this object. Private to the sources of the
/// pages.
class HttpLine {
 public:
  /// Called with how many bytes were read or written; 0 for other operations.
  using Done = std::function<void(boost::system::error_code, std::size_t)>;
  enum class Side { client, server };

  /// \param tls its settings, which this object shares; null: without TLS
  HttpLine(boost::asio::ip::tcp::socket socket, ssl_ctx_st* tls);
  ~HttpLine();
  HttpLine(const HttpLine&) = delete;
  HttpLine& operator=(const HttpLine&) = delete;

  boost::asio::ip::tcp::socket& socket();
  ssl_st* tls();  ///< null: without TLS

  /// Until when the operations that begin from now on must have ended; they fail otherwise.
  void expires_after(std::chrono::nanoseconds limit);
  void expires_never();
  void close();

  void connect(const boost::asio::ip::tcp::resolver::results_type& places, Done done);
  void shake_hands(Side side, Done done);                       ///< only with TLS
  void read_some(boost::asio::mutable_buffer into, Done done);  ///< at least a byte
  void write(boost::asio::const_buffer bytes, Done done);       ///< all bytes, which the caller keeps until then
  void say_goodbye(Done done);  ///< only with TLS: its end, which the reader can tell from a cut

 private:
  struct Impl;
  const std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::rpc
