#include <functional>
#include <optional>
#include <stdexcept>
#include <thread>
#include <utility>

#include <boost/asio/buffer.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/read_size.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http/error.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/status.hpp>
#include <boost/beast/http/string_body.hpp>

#include <iotcloud/drivers/http/http_end.h>

namespace iotcloud::drivers::http {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace wire = beast::http;
using boost::system::error_code;
using Tcp = asio::ip::tcp;
/// Called with how many bytes were read or written.
using Done = std::function<void(error_code, std::size_t)>;

constexpr std::uint32_t longest_head = 8192;
/// The most time for a whole request, however slowly its bytes come, and for taking the answer.
constexpr std::chrono::seconds request_limit{15};
/// How long nothing is accepted when descriptors or memory have run out.
constexpr std::chrono::milliseconds accept_pause{100};

/// What all connections of a server share.
struct Server {
  ServerOptions options;
  std::function<WebhookAnswer(const Webhook&)> handler;
  std::size_t open = 0;
};

std::string text_of(const Tcp::endpoint& endpoint) {
  const std::string address = endpoint.address().to_string();
  return (endpoint.address().is_v6() ? "[" + address + "]" : address) + ":" + std::to_string(endpoint.port());
}

std::string text_of(beast::string_view text) {
  return {text.data(), text.size()};
}

/// Whether the head says that the body is longer than this. Beast forgets that it has found so when the body comes in a
/// later packet; of bodies in chunks it looks at each.
template <typename Parser>
bool is_too_long(const Parser& parser, std::size_t most) {
  const auto length = parser.content_length();
  return length && *length > most;
}

/// TCP. All handlers have one type, so that Asio's operations, which are templates, are compiled once (as in
/// rpc/http/http_line.h, which a driver may not use).
class Plain {
 public:
  using executor_type = beast::tcp_stream::executor_type;
  using lowest_layer_type = Plain;

  explicit Plain(Tcp::socket socket) : stream(std::move(socket)) {}
  executor_type get_executor() { return stream.get_executor(); }
  lowest_layer_type& lowest_layer() { return *this; }

  template <typename Buffers, typename Handler>
  void async_read_some(const Buffers& buffers, Handler handler) {
    read_some(*asio::buffer_sequence_begin(buffers), Done(std::move(handler)));
  }
  template <typename Buffers, typename Handler>
  void async_write_some(const Buffers& buffers, Handler handler) {
    write_some(*asio::buffer_sequence_begin(buffers), Done(std::move(handler)));
  }
  void read_some(asio::mutable_buffer into, Done done) { stream.async_read_some(into, std::move(done)); }
  void write_some(asio::const_buffer bytes, Done done) { stream.async_write_some(bytes, std::move(done)); }

  beast::tcp_stream stream;
};

/// A connection, with TLS or without.
struct Line {
  /// \param context null: without TLS
  Line(Tcp::socket socket, asio::ssl::context* context) : plain(std::move(socket)) {
    if (context != nullptr) tls.emplace(plain, *context);
  }

  void shake_hands(asio::ssl::stream_base::handshake_type side, std::function<void(error_code)> done) {
    if (!tls) return done({});
    tls->async_handshake(side, std::move(done));
  }
  void read_some(asio::mutable_buffer into, Done done) {
    if (tls) return tls->async_read_some(into, std::move(done));
    plain.read_some(into, std::move(done));
  }
  void write(const std::string& bytes, Done done) {
    if (tls) return asio::async_write(*tls, asio::buffer(bytes), std::move(done));
    asio::async_write(plain, asio::buffer(bytes), std::move(done));
  }

  Plain plain;
  std::optional<asio::ssl::stream<Plain&>> tls;
  beast::flat_buffer buffer{};  ///< what was read, and not parsed yet
};

enum class Part { head, whole };

/// Reads until the parser has this part of a message. `done` keeps the line and the parser alive.
template <bool is_request>
void read_message(Line& line, wire::basic_parser<is_request>& parser, Part part, std::function<void(error_code)> done) {
  constexpr std::size_t most_at_once = 65'536;
  error_code error;
  parser.eager(part == Part::whole);
  while (!error && !(part == Part::head ? parser.is_header_done() : parser.is_done())) {
    if (line.buffer.size() > 0) {
      line.buffer.consume(parser.put(line.buffer.data(), error));
      if (error != wire::error::need_more) continue;
      error = {};
    }
    return line.read_some(line.buffer.prepare(beast::read_size(line.buffer, most_at_once)),
                          [&line, &parser, part, done = std::move(done)](error_code failure, std::size_t count) {
                            line.buffer.commit(count);
                            if (failure == asio::error::eof) {
                              failure = {};
                              if (parser.got_some()) {
                                parser.put_eof(failure);
                              } else {
                                failure = wire::error::end_of_stream;
                              }
                            }
                            if (failure) return done(failure);
                            read_message(line, parser, part, done);
                          });
  }
  done(error);
}

/// A connection of somebody who sends requests, one after the other.
class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(Tcp::socket socket, asio::ssl::context* tls, std::shared_ptr<Server> server, std::string peer)
      : line_(std::move(socket), tls), server_(std::move(server)), peer_(std::move(peer)) {
    ++server_->open;
  }
  ~Session() { --server_->open; }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void run() {
    limit();
    line_.shake_hands(asio::ssl::stream_base::server, [self = shared_from_this()](error_code error) {
      if (!error) self->read();
    });
  }

 private:
  void limit() { line_.plain.stream.expires_after(request_limit); }

  void read() {
    limit();
    parser_.emplace();
    parser_->header_limit(longest_head);
    parser_->body_limit(server_->options.most_bytes);
    read_message(line_, *parser_, Part::head, [self = shared_from_this()](error_code error) {
      if (error || is_too_long(*self->parser_, self->server_->options.most_bytes))
        return self->received(error ? error : wire::error::body_limit);
      self->read_body();
    });
  }

  void read_body() {
    read_message(line_, *parser_, Part::whole,
                 [self = shared_from_this()](error_code error) { self->received(error); });
  }

  void received(error_code error) {
    if (error == wire::error::body_limit) return answer({413, "The request is too long.\n"}, false);
    if (error == wire::error::header_limit) return answer({431, "The request's head is too long.\n"}, false);
    if (error == wire::error::end_of_stream) return;
    if (error) {
      if (error.category() == make_error_code(wire::error::bad_method).category())
        answer({400, "This is no HTTP request.\n"}, false);
      return;
    }
    auto& request = parser_->get();
    const std::string target = text_of(request.target());
    const auto question = target.find('?');
    Webhook webhook;
    webhook.method = text_of(request.method_string());
    webhook.path = target.substr(0, question);
    webhook.query = question == std::string::npos ? "" : target.substr(question + 1);
    webhook.content_type = text_of(request[wire::field::content_type]);
    webhook.authorization = text_of(request[wire::field::authorization]);
    webhook.peer = peer_;
    webhook.body = std::move(request.body());
    WebhookAnswer told{500, "It cannot be taken.\n"};
    try {
      told = server_->handler(webhook);
    } catch (const std::exception&) {  // no memory
    }
    answer(told, request.keep_alive());
  }

  void answer(const WebhookAnswer& answer, bool goes_on) {
    limit();
    answer_ = "HTTP/1.1 " + std::to_string(answer.status) + " " +
              text_of(wire::obsolete_reason(static_cast<wire::status>(answer.status))) + "\r\n";
    if (!goes_on) answer_ += "Connection: close\r\n";
    if (answer.retry_after_s > 0) answer_ += "Retry-After: " + std::to_string(answer.retry_after_s) + "\r\n";
    if (answer.status == 401) answer_ += "WWW-Authenticate: Bearer\r\n";
    if (!answer.text.empty()) answer_ += "Content-Type: text/plain\r\n";
    if (answer.status != 204) answer_ += "Content-Length: " + std::to_string(answer.text.size()) + "\r\n";
    answer_ += "\r\n" + answer.text;
    line_.write(answer_, [self = shared_from_this(), goes_on](error_code error, std::size_t) {
      if (!error && goes_on) return self->read();
      error_code ignored;
      self->line_.plain.stream.socket().shutdown(Tcp::socket::shutdown_send, ignored);
    });
  }

  Line line_;
  const std::shared_ptr<Server> server_;
  const std::string peer_;
  std::optional<wire::request_parser<wire::string_body>> parser_;
  std::string answer_;  ///< that is being sent
};

/// One call, on a connection of its own.
class Calling : public std::enable_shared_from_this<Calling> {
 public:
  /// \param tls its settings, for this call alone; null: without TLS
  Calling(asio::io_context& context, asio::ssl::context* tls, Call call, std::function<void(CallAnswer)> handler)
      : resolver_(context), line_(Tcp::socket(context), tls), call_(std::move(call)), handler_(std::move(handler)) {
    parser_.body_limit(call_.most_bytes);
    if (line_.tls) line_.tls->set_verify_callback(asio::ssl::host_name_verification(call_.host));
  }

  void run() {
    resolver_.async_resolve(call_.host, call_.port, [self = shared_from_this()](error_code error, const auto& found) {
      if (error) return self->fail("its name has no address", error);
      self->limit();
      self->line_.plain.stream.async_connect(found, [self](error_code problem, const Tcp::endpoint&) {
        if (problem) return self->fail("it cannot be reached", problem);
        self->shake_hands();
      });
    });
  }

 private:
  void limit() { line_.plain.stream.expires_after(call_.limit); }

  void shake_hands() {
    limit();
    if (line_.tls)
      SSL_ctrl(line_.tls->native_handle(), SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name, call_.host.data());
    line_.shake_hands(asio::ssl::stream_base::client, [self = shared_from_this()](error_code error) {
      if (error) return self->fail("TLS", error);
      self->write();
    });
  }

  void write() {
    limit();
    request_ = call_.method + " " + call_.target + " HTTP/1.1\r\nHost: " + call_.host + ":" + call_.port +
               "\r\nUser-Agent: iotcloud\r\nConnection: close\r\n";
    if (!call_.content_type.empty()) request_ += "Content-Type: " + call_.content_type + "\r\n";
    if (!call_.authorization.empty()) request_ += "Authorization: " + call_.authorization + "\r\n";
    if (!call_.body.empty() || call_.method == "POST" || call_.method == "PUT" || call_.method == "OPTIONS")
      request_ += "Content-Length: " + std::to_string(call_.body.size()) + "\r\n";
    request_ += "\r\n" + call_.body;
    line_.write(request_, [self = shared_from_this()](error_code error, std::size_t) {
      if (error) return self->fail("it took no request", error);
      self->read();
    });
  }

  void read() {
    limit();
    if (call_.method == "HEAD") parser_.skip(true);
    read_message(line_, parser_, Part::head, [self = shared_from_this()](error_code error) {
      if (!error && self->call_.method != "HEAD" && is_too_long(self->parser_, self->call_.most_bytes))
        error = wire::error::body_limit;
      if (error) return self->fail("its answer", error);
      self->read_body();
    });
  }

  void read_body() {
    read_message(line_, parser_, Part::whole, [self = shared_from_this()](error_code error) {
      if (error) return self->fail("its answer", error);
      auto& response = self->parser_.get();
      CallAnswer answer;
      answer.status = static_cast<int>(response.result_int());
      answer.content_type = text_of(response[wire::field::content_type]);
      answer.body = std::move(response.body());
      self->handler_(std::move(answer));
    });
  }

  void fail(const std::string& step, error_code error) { fail(step + ": " + error.message()); }
  void fail(const std::string& why) {
    CallAnswer answer;
    answer.problem = call_.host + ":" + call_.port + ": " + why;
    handler_(std::move(answer));
  }

  Tcp::resolver resolver_;
  Line line_;
  Call call_;
  const std::function<void(CallAnswer)> handler_;
  std::string request_;
  wire::response_parser<wire::string_body> parser_;
};

}  // namespace

struct HttpEnd::Impl {
  asio::io_context context;
  asio::executor_work_guard<asio::io_context::executor_type> work{context.get_executor()};
  std::optional<Tcp::acceptor> acceptor;
  asio::steady_timer pause{context};
  std::optional<asio::ssl::context> server_tls;
  std::shared_ptr<Server> server;
  std::thread thread{[this] { run(); }};

  /// A handler that has no memory ends its connection, and no other.
  void run() {
    for (bool ended = false; !ended;) {
      try {
        context.run();
        ended = true;
      } catch (const std::exception&) {
      }
    }
  }

  ~Impl() {
    context.stop();
    thread.join();
  }

  void accept() {
    acceptor->async_accept([this](error_code error, Tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      if (error) {
        pause.expires_after(accept_pause);
        return pause.async_wait([this](error_code) { accept(); });
      }
      if (server->open < server->options.connections) take(std::move(socket));
      accept();
    });
  }

  void take(Tcp::socket socket) {
    error_code gone;
    const std::string peer = text_of(socket.remote_endpoint(gone));
    if (gone) return;
    std::make_shared<Session>(std::move(socket), server_tls ? &*server_tls : nullptr, server, peer)->run();
  }
};

HttpEnd::HttpEnd() : impl_(std::make_unique<Impl>()) {}
HttpEnd::~HttpEnd() = default;

std::string HttpEnd::serve(const ServerOptions& options, std::function<WebhookAnswer(const Webhook&)> handler) {
  impl_->server = std::make_shared<Server>(Server{options, std::move(handler)});
  try {
    if (!options.certificate.empty()) {
      impl_->server_tls.emplace(asio::ssl::context::tls_server);
      SSL_CTX_set_min_proto_version(impl_->server_tls->native_handle(), TLS1_2_VERSION);
      impl_->server_tls->use_certificate_chain_file(options.certificate);
      impl_->server_tls->use_private_key_file(options.key, asio::ssl::context::pem);
    }
    impl_->acceptor.emplace(impl_->context, Tcp::endpoint(asio::ip::make_address(options.address), options.port));
  } catch (const boost::system::system_error& e) {
    throw std::runtime_error("cannot serve webhooks at " + options.address + ":" + std::to_string(options.port) + ": " +
                             e.what());
  }
  std::string address = text_of(impl_->acceptor->local_endpoint());
  asio::post(impl_->context, [impl = impl_.get()] { impl->accept(); });
  return address;
}

void HttpEnd::call(Call call, std::function<void(CallAnswer)> handler) {
  try {
    std::optional<asio::ssl::context> tls;  // the connection keeps a reference of its own
    if (call.tls) {
      tls.emplace(asio::ssl::context::tls_client);
      SSL_CTX_set_min_proto_version(tls->native_handle(), TLS1_2_VERSION);
      if (call.ca.empty()) {
        tls->set_default_verify_paths();
      } else {
        tls->load_verify_file(call.ca);
      }
      tls->set_verify_mode(asio::ssl::verify_peer);
    }
    const auto calling =
        std::make_shared<Calling>(impl_->context, tls ? &*tls : nullptr, std::move(call), std::move(handler));
    asio::post(impl_->context, [calling] { calling->run(); });
  } catch (const boost::system::system_error& e) {
    throw std::runtime_error(std::string("TLS: ") + e.what());
  }
}

}  // namespace iotcloud::drivers::http
