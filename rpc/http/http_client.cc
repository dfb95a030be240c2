#include <chrono>
#include <functional>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/string_body.hpp>
#include <fmt/format.h>

#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/http/http_client.h>
#include <iotcloud/rpc/http/http_line.h>
#include <iotcloud/rpc/http/http_message.h>

namespace iotcloud::rpc {

namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
using boost::system::error_code;

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
      HttpLine line(tcp::socket(io_), nullptr);
      const tcp::endpoint at(host, static_cast<std::uint16_t>(std::stoi(to.port)));
      const auto place = tcp::resolver::results_type::create(at, to.host, to.port);
      complete(line, [&](auto done) { line.connect(place, done); });
      return read(line, target);
    }
    const security::TlsContext tls(reader_.tls, security::TlsContext::Side::client);
    HttpLine line(tcp::socket(io_), tls.get());
    security::expect_host(line.tls(), to.host);
    tcp::resolver resolver(io_);
    error_code unknown;
    const auto places = resolver.resolve(to.host, to.port, tcp::resolver::numeric_service, unknown);
    if (unknown) throw HttpUnreachable(fmt::format("{} does not answer: {}", address_, unknown.message()));
    complete(line, [&](auto done) { line.connect(places, done); });
    complete(line, [&](auto done) { line.shake_hands(HttpLine::Side::client, done); });
    return read(line, target);
  }

 private:
  using tcp = asio::ip::tcp;

  /// Runs one asynchronous operation until its end or its time-out. \throws HttpError, HttpUnreachable
  void complete(HttpLine& line, const std::function<void(HttpLine::Done)>& begin) {
    error_code result;
    line.expires_after(patience);
    begin([&result](error_code error, std::size_t) { result = error; });
    io_.restart();
    io_.run();
    const auto& of_http = http::make_error_code(http::error::end_of_stream);
    if (result && result != of_http && result.category() == of_http.category())
      throw HttpError(fmt::format("{}: {}", address_, result.message()));
    if (result) throw HttpUnreachable(fmt::format("{} does not answer: {}", address_, result.message()));
  }

  std::string read(HttpLine& line, const std::string& target) {
    std::string request = fmt::format("GET {} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n", target, address_);
    if (!reader_.token.empty()) request += fmt::format("Authorization: Bearer {}\r\n", reader_.token);
    request += "\r\n";
    complete(line, [&](auto done) { line.write(asio::buffer(request), done); });
    boost::beast::flat_buffer buffer;
    http::response_parser<http::string_body> response;
    response.body_limit(reader_.largest_page);
    // The header by itself: where a part of the body comes with it, Beast 1.74 goes on after a length above the limit,
    // and takes memory for it.
    for (const HttpPart part : {HttpPart::head, HttpPart::whole}) {
      complete(line, [&](auto done) {
        read_message(line, buffer, response, part, [done](error_code error) { done(error, 0); });
      });
    }
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
