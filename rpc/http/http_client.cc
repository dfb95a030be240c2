#include <algorithm>
#include <chrono>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <fmt/format.h>

#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::rpc {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;

constexpr std::chrono::seconds patience{5};
constexpr std::size_t largest_page = 64U << 20U;

/// Runs one asynchronous operation of `stream` until its end or its time-out. \throws boost::system::system_error
template <typename Begin>
void complete(asio::io_context& io, beast::tcp_stream& stream, Begin&& begin) {
  boost::system::error_code result;
  stream.expires_after(patience);
  begin([&result](boost::system::error_code error, auto&&...) { result = error; });
  io.restart();
  io.run();
  if (result) throw boost::system::system_error(result);
}

}  // namespace

std::string http_get(const std::string& address, const std::string& target) {
  const auto colon = std::min(address.rfind(':'), address.size());
  try {
    asio::io_context io{1};
    beast::tcp_stream stream(io);
    const auto host = asio::ip::make_address(address.substr(0, colon));
    if (!host.is_loopback()) throw HttpError(address + " is not on this machine");
    const auto port = static_cast<std::uint16_t>(std::stoi(address.substr(std::min(colon + 1, address.size()))));
    complete(io, stream, [&](auto done) { stream.async_connect(asio::ip::tcp::endpoint(host, port), done); });
    http::request<http::empty_body> request(http::verb::get, target, 11);
    request.set(http::field::host, address);
    request.keep_alive(false);
    complete(io, stream, [&](auto done) { http::async_write(stream, request, done); });
    beast::flat_buffer buffer;
    http::response_parser<http::string_body> response;
    response.body_limit(largest_page);
    complete(io, stream, [&](auto done) { http::async_read(stream, buffer, response, done); });
    if (response.get().result() != http::status::ok) {
      throw HttpError(fmt::format("{}{}: {}", address, target.substr(0, target.find('?')), response.get().body()));
    }
    return std::move(response.get().body());
  } catch (const HttpError&) {
    throw;
  } catch (const std::exception& e) {
    throw HttpError(fmt::format("{} does not answer: {}", address, e.what()));
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
