#include <optional>
#include <utility>

#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <openssl/ssl.h>

#include <iotcloud/rpc/http/http_line.h>

namespace iotcloud::rpc {

namespace asio = boost::asio;
using boost::system::error_code;

namespace {

/// The stream below TLS.
class Transport {
 public:
  using executor_type = boost::beast::tcp_stream::executor_type;
  using lowest_layer_type = Transport;

  explicit Transport(asio::ip::tcp::socket socket) : stream(std::move(socket)) {}
  executor_type get_executor() { return stream.get_executor(); }
  lowest_layer_type& lowest_layer() { return *this; }

  template <typename Buffers, typename Handler>
  void async_read_some(const Buffers& buffers, Handler handler) {
    read_some(*asio::buffer_sequence_begin(buffers), HttpLine::Done(std::move(handler)));
  }
  template <typename Buffers, typename Handler>
  void async_write_some(const Buffers& buffers, Handler handler) {
    write_some(*asio::buffer_sequence_begin(buffers), HttpLine::Done(std::move(handler)));
  }
  void read_some(asio::mutable_buffer into, HttpLine::Done done) { stream.async_read_some(into, std::move(done)); }
  void write_some(asio::const_buffer bytes, HttpLine::Done done) { stream.async_write_some(bytes, std::move(done)); }

  boost::beast::tcp_stream stream;
};

}  // namespace

struct HttpLine::Impl {
  Impl(asio::ip::tcp::socket socket, ssl_ctx_st* settings) : transport(std::move(socket)) {
    if (settings == nullptr) return;
    SSL_CTX_up_ref(settings);
    asio::ssl::context context(settings);  // owns the reference
    tls.emplace(transport, context);
  }

  Transport transport;
  std::optional<asio::ssl::stream<Transport&>> tls;
};

HttpLine::HttpLine(asio::ip::tcp::socket socket, ssl_ctx_st* tls)
    : impl_(std::make_unique<Impl>(std::move(socket), tls)) {}
HttpLine::~HttpLine() = default;

asio::ip::tcp::socket& HttpLine::socket() {
  return impl_->transport.stream.socket();
}

ssl_st* HttpLine::tls() {
  return impl_->tls ? impl_->tls->native_handle() : nullptr;
}

void HttpLine::expires_after(std::chrono::nanoseconds limit) {
  impl_->transport.stream.expires_after(limit);
}

void HttpLine::expires_never() {
  impl_->transport.stream.expires_never();
}

void HttpLine::close() {
  impl_->transport.stream.close();
}

void HttpLine::connect(const asio::ip::tcp::resolver::results_type& places, Done done) {
  impl_->transport.stream.async_connect(
      places, [done = std::move(done)](error_code error, const asio::ip::tcp::endpoint&) { done(error, 0); });
}

void HttpLine::shake_hands(Side side, Done done) {
  impl_->tls->async_handshake(side == Side::client ? asio::ssl::stream_base::client : asio::ssl::stream_base::server,
                              [done = std::move(done)](error_code error) { done(error, 0); });
}

void HttpLine::read_some(asio::mutable_buffer into, Done done) {
  if (impl_->tls) return impl_->tls->async_read_some(into, std::move(done));
  impl_->transport.read_some(into, std::move(done));
}

void HttpLine::write(asio::const_buffer bytes, Done done) {
  if (impl_->tls) return asio::async_write(*impl_->tls, bytes, std::move(done));
  asio::async_write(impl_->transport, bytes, std::move(done));
}

void HttpLine::say_goodbye(Done done) {
  impl_->tls->async_shutdown([done = std::move(done)](error_code error) { done(error, 0); });
}

}  // namespace iotcloud::rpc
