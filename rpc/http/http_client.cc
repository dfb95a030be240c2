#include <chrono>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <fmt/format.h>

#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::rpc {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;

constexpr std::chrono::seconds patience{5};

/// One connection, whose every step has a time-out.
class Asking {
 public:
  Asking(const std::string& address, const HttpReader& reader) : address_(address), reader_(reader) {}

  std::string page(const std::string& target) {
    const HttpAddress to(address_);
    if (reader_.tls.empty()) {
      const auto host = asio::ip::make_address(to.host);
      if (!host.is_loopback()) throw HttpError(address_ + " is on another machine, and is asked by TLS only");
      beast::tcp_stream stream(io_);
      const tcp::endpoint at(host, static_cast<std::uint16_t>(std::stoi(to.port)));
      complete(stream, [&](auto done) { stream.async_connect(at, done); });
      return read(stream, target);
    }
    const security::TlsContext tls(reader_.tls, security::TlsContext::Side::client);
    SSL_CTX_up_ref(tls.get());
    asio::ssl::context context(tls.get());  // owns the reference
    beast::ssl_stream<beast::tcp_stream> stream(io_, context);
    security::expect_host(stream.native_handle(), to.host);
    auto& connection = beast::get_lowest_layer(stream);
    tcp::resolver resolver(io_);
    boost::system::error_code unknown;
    const auto places = resolver.resolve(to.host, to.port, tcp::resolver::numeric_service, unknown);
    if (unknown) throw HttpUnreachable(fmt::format("{} does not answer: {}", address_, unknown.message()));
    complete(connection, [&](auto done) { connection.async_connect(places, done); });
    complete(connection, [&](auto done) { stream.async_handshake(asio::ssl::stream_base::client, done); });
    return read(stream, target);
  }

 private:
  using tcp = asio::ip::tcp;

  /// Runs one asynchronous operation until its end or its time-out. \throws HttpError, HttpUnreachable
  template <typename Begin>
  void complete(beast::tcp_stream& stream, Begin&& begin) {
    boost::system::error_code result;
    stream.expires_after(patience);
    begin([&result](boost::system::error_code error, auto&&...) { result = error; });
    io_.restart();
    io_.run();
    const auto& of_http = http::make_error_code(http::error::end_of_stream);
    if (result && result != of_http && result.category() == of_http.category())
      throw HttpError(fmt::format("{}: {}", address_, result.message()));
    if (result) throw HttpUnreachable(fmt::format("{} does not answer: {}", address_, result.message()));
  }

  template <typename Stream>
  std::string read(Stream& stream, const std::string& target) {
    auto& connection = beast::get_lowest_layer(stream);
    http::request<http::empty_body> request(http::verb::get, target, 11);
    request.set(http::field::host, address_);
    if (!reader_.token.empty()) request.set(http::field::authorization, "Bearer " + reader_.token);
    request.keep_alive(false);
    complete(connection, [&](auto done) { http::async_write(stream, request, done); });
    beast::flat_buffer buffer;
    http::response_parser<http::string_body> response;
    response.body_limit(reader_.largest_page);
    // The header by itself: where a part of the body comes with it, Beast 1.74 goes on after a length above the limit,
    // and takes memory for it.
    complete(connection, [&](auto done) { http::async_read_header(stream, buffer, response, done); });
    complete(connection, [&](auto done) { http::async_read(stream, buffer, response, done); });
    if (response.get().result() != http::status::ok) {
      throw HttpError(fmt::format("{}{}: {}", address_, target.substr(0, target.find('?')), response.get().body()));
    }
    return std::move(response.get().body());
  }

  const std::string& address_;
  const HttpReader& reader_;
  asio::io_context io_{1};
};

}  // namespace

std::string http_get(const std::string& address, const std::string& target, const HttpReader& reader) {
  try {
    return Asking(address, reader).page(target);
  } catch (const HttpError&) {
    throw;
  } catch (const std::exception& e) {
    throw HttpError(fmt::format("{} cannot be asked: {}", address, e.what()));
  }
}

std::string encode_query(const std::string& text) {
  std::string out;
  for (const unsigned char c : text) {
    const bool plain = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '-' ||
                       c == '_' || c == '.' || c == '~';
    out += plain ? std::string(1, static_cast<char>(c)) : fmt::format("%{:02X}", c);
  }
  return out;
}

}  // namespace iotcloud::rpc
