#include <charconv>
#include <list>
#include <optional>
#include <string_view>
#include <thread>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/version.hpp>
#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/rpc/refusal_log.h>

namespace iotcloud::rpc {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using boost::system::error_code;
using tcp = asio::ip::tcp;

constexpr std::size_t most_connections = 64;
constexpr std::uint32_t longest_head = 8192;
/// From the moment the server waits for a request until all of it is there, however it comes; and until its answer has
/// been taken.
constexpr std::chrono::seconds request_limit{15}, answer_limit{15};
/// How long nothing is accepted when descriptors or memory have run out.
constexpr std::chrono::milliseconds accept_pause{100};

std::pair<std::string, std::string> split_address(const std::string& address) {
  const auto colon = address.rfind(':');
  if (colon == std::string::npos) return {address, ""};
  std::string host = address.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  return {host, address.substr(colon + 1)};
}

std::string decode(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    unsigned code = 0;
    const char* hex = text.data() + i + 1;
    if (text[i] == '%' && i + 2 < text.size() && std::from_chars(hex, hex + 2, code, 16).ptr == hex + 2) {
      out += static_cast<char>(code);
      i += 2;
    } else {
      out += text[i] == '+' ? ' ' : text[i];
    }
  }
  return out;
}

HttpRequest parse_target(std::string_view target) {
  HttpRequest request;
  const auto question = target.find('?');
  request.path = decode(target.substr(0, question));
  while (question != std::string_view::npos && !target.empty()) {
    target.remove_prefix(target.find_first_of("?&") + 1);
    const std::string_view pair = target.substr(0, target.find('&'));
    const auto equals = std::min(pair.find('='), pair.size());
    if (!pair.empty())
      request.query[decode(pair.substr(0, equals))] = decode(pair.substr(std::min(equals + 1, pair.size())));
    if (pair.size() == target.size()) break;
    target.remove_prefix(pair.size());
  }
  return request;
}

using Pages = std::map<std::string, HttpHandler>;

HttpAnswer answer_to(const Pages& pages, std::string_view target) {
  const HttpRequest request = parse_target(target);
  const auto page = pages.find(request.path);
  if (page == pages.end()) {
    std::string known = "no such page; there are:";
    for (const auto& [path, handler] : pages) known += " " + path;
    return {404, "text/plain", known + "\n"};
  }
  try {
    return page->second(request);
  } catch (const std::exception& error) {
    return {500, "text/plain", std::string(error.what()) + "\n"};
  }
}

class Connection;

/// The server's open connections, in the order in which they began what they are at: to wait for a request, or to send
/// an answer. Used by the server's thread.
using Connections = std::list<Connection*>;

/// One connection. Lives as long as one of its operations is pending.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(tcp::socket socket, const Pages& pages, Connections& all)
      : stream_(std::move(socket)), pages_(pages), all_(all), place_(all_.insert(all_.end(), this)) {}
  ~Connection() {
    if (open_) all_.erase(place_);
  }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  void cut() {
    all_.erase(place_);
    open_ = false;
    stream_.close();
  }

  void read() {
    begin();
    parser_.emplace();
    parser_->header_limit(longest_head);
    parser_->body_limit(0);
    stream_.expires_after(request_limit);
    http::async_read(stream_, buffer_, *parser_, [self = shared_from_this()](error_code error, std::size_t) {
      if (!error && self->open_) self->write();
    });
  }

 private:
  void begin() { all_.splice(all_.end(), all_, place_); }

  void write() {
    begin();
    const auto& request = parser_->get();
    response_ = {};
    response_.version(request.version());
    response_.keep_alive(request.keep_alive());
    response_.set(http::field::server, "iotcloud");
    const bool head = request.method() == http::verb::head;
    if (head || request.method() == http::verb::get) {
      const auto target = request.target();
      HttpAnswer answer = answer_to(pages_, {target.data(), target.size()});
      response_.result(static_cast<unsigned>(answer.status));
      response_.set(http::field::content_type, answer.content_type);
      response_.content_length(answer.body.size());
      if (!head) response_.body() = std::move(answer.body);
    } else {
      response_.result(http::status::method_not_allowed);
      response_.set(http::field::allow, "GET, HEAD");
      response_.prepare_payload();
    }
    stream_.expires_after(answer_limit);
    serializer_.emplace(response_);
    serializer_->split(head);
    const auto done = [self = shared_from_this()](error_code error, std::size_t) {
      if (error || !self->open_) return;
      if (self->response_.keep_alive()) return self->read();
      error_code ignored;
      self->stream_.socket().shutdown(tcp::socket::shutdown_send, ignored);
    };
    if (head) {
      http::async_write_header(stream_, *serializer_, done);
    } else {
      http::async_write(stream_, *serializer_, done);
    }
  }

  beast::tcp_stream stream_;
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::empty_body>> parser_;
  http::response<http::string_body> response_;
  std::optional<http::response_serializer<http::string_body>> serializer_;
  const Pages& pages_;
  Connections& all_;
  const Connections::iterator place_;
  bool open_ = true;  ///< it has its place; false: it was cut, and ends when its operation has
};

}  // namespace

struct HttpServer::Impl {
  Impl(const std::string& address, Pages handlers) : pages(std::move(handlers)), acceptor(io) {
    std::tie(host, std::ignore) = split_address(address);
    tcp::resolver resolver(io);
    const auto [name, port] = split_address(address);
    const auto found = resolver.resolve(name, port, tcp::resolver::passive | tcp::resolver::numeric_service);
    const tcp::endpoint endpoint = *found.begin();
    acceptor.open(endpoint.protocol());
    acceptor.set_option(asio::socket_base::reuse_address(true));
    acceptor.bind(endpoint);
    acceptor.listen();
    bound_port = acceptor.local_endpoint().port();
    accept();
    thread = std::thread([this] { io.run(); });
  }
  ~Impl() {
    io.stop();
    if (thread.joinable()) thread.join();
  }

  void accept() {
    acceptor.async_accept([this](error_code error, tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      if (!error) {
        make_room();
        std::make_shared<Connection>(std::move(socket), pages, connections)->read();
      } else if (error != asio::error::connection_aborted) {
        refused("accept", "a connection cannot be accepted: " + error.message());
        pause.expires_after(accept_pause);
        pause.async_wait([this](error_code ended) {
          if (!ended) accept();
        });
        return;
      }
      accept();
    });
  }

  /// If there are too many connections, cuts the one that has been the longest at its request, or at taking its answer:
  /// who asks and reads at once, such as a probe of /healthz, is always answered.
  void make_room() {
    if (connections.size() < most_connections) return;
    refused("connections", fmt::format("there are {} connections already; the one that has been the longest at its "
                                       "request, or at taking its answer, is cut off",
                                       connections.size()));
    connections.front()->cut();
  }

  void refused(const std::string& reason, const std::string& text) {
    log.refused(reason, "the pages at port " + std::to_string(bound_port) + ": " + text);
    config::process_metrics()
        .counter("iotcloud_http_refused_total", "Connections that a daemon's HTTP server refused or cut off",
                 {{"reason", reason}})
        .add();
  }

  const Pages pages;
  std::string host;
  std::uint16_t bound_port = 0;
  RefusalLog log{config::Logger{"http"}};
  Connections connections;  ///< declared before `io`, whose destructor destroys connections
  asio::io_context io{1};
  tcp::acceptor acceptor;
  asio::steady_timer pause{io};
  std::thread thread;
};

HttpServer::HttpServer(const std::string& address, std::map<std::string, HttpHandler> pages) {
  try {
    impl_ = std::make_unique<Impl>(address, std::move(pages));
  } catch (const std::exception& e) {
    throw config::Error("pages cannot be served at " + address + " (" + e.what() +
                        "); is the address of the form host:port, and the port free?");
  }
}

HttpServer::~HttpServer() = default;

std::string HttpServer::address() const {
  const bool six = impl_->host.find(':') != std::string::npos;
  return (six ? "[" + impl_->host + "]" : impl_->host) + ":" + std::to_string(impl_->bound_port);
}

bool is_loopback_address(const std::string& address) {
  const auto [host, port] = split_address(address);
  if (host == "localhost") return true;
  error_code error;
  const auto parsed = asio::ip::make_address(host, error);
  return !error && parsed.is_loopback();
}

}  // namespace iotcloud::rpc
