#include <optional>
#include <stdexcept>
#include <thread>
#include <type_traits>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>

#include <iotcloud/drivers/http/http_end.h>

namespace iotcloud::drivers::http {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace wire = beast::http;
using boost::system::error_code;
using Tcp = asio::ip::tcp;
using Plain = beast::tcp_stream;
using Tls = beast::ssl_stream<beast::tcp_stream>;

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

/// A connection of somebody who sends requests, one after the other.
template <typename Stream>
class Session : public std::enable_shared_from_this<Session<Stream>> {
 public:
  Session(Stream stream, std::shared_ptr<Server> server, std::string peer)
      : stream_(std::move(stream)), server_(std::move(server)), peer_(std::move(peer)) {
    ++server_->open;
  }
  ~Session() { --server_->open; }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void run() {
    limit();
    if constexpr (std::is_same_v<Stream, Tls>) {
      stream_.async_handshake(asio::ssl::stream_base::server, [self = this->shared_from_this()](error_code error) {
        if (!error) self->read();
      });
    } else {
      read();
    }
  }

 private:
  void limit() { beast::get_lowest_layer(stream_).expires_after(request_limit); }

  void read() {
    limit();
    parser_.emplace();
    parser_->header_limit(longest_head);
    parser_->body_limit(server_->options.most_bytes);
    wire::async_read_header(stream_, buffer_, *parser_,
                            [self = this->shared_from_this()](error_code error, std::size_t) {
                              if (error || is_too_long(*self->parser_, self->server_->options.most_bytes))
                                return self->received(error ? error : wire::error::body_limit);
                              self->read_body();
                            });
  }

  void read_body() {
    wire::async_read(stream_, buffer_, *parser_,
                     [self = this->shared_from_this()](error_code error, std::size_t) { self->received(error); });
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
    response_ = {};
    response_.version(11);
    response_.result(static_cast<unsigned>(answer.status));
    response_.keep_alive(goes_on);
    if (answer.retry_after_s > 0) response_.set(wire::field::retry_after, std::to_string(answer.retry_after_s));
    if (answer.status == 401) response_.set(wire::field::www_authenticate, "Bearer");
    if (!answer.text.empty()) response_.set(wire::field::content_type, "text/plain");
    response_.body() = answer.text;
    if (answer.status != 204) response_.prepare_payload();
    wire::async_write(stream_, response_, [self = this->shared_from_this(), goes_on](error_code error, std::size_t) {
      if (!error && goes_on) return self->read();
      error_code ignored;
      beast::get_lowest_layer(self->stream_).socket().shutdown(Tcp::socket::shutdown_send, ignored);
    });
  }

  Stream stream_;
  const std::shared_ptr<Server> server_;
  const std::string peer_;
  beast::flat_buffer buffer_;
  std::optional<wire::request_parser<wire::string_body>> parser_;
  wire::response<wire::string_body> response_;
};

/// One call, on a connection of its own.
template <typename Stream>
class Calling : public std::enable_shared_from_this<Calling<Stream>> {
 public:
  Calling(asio::io_context& context, Stream stream, Call call, std::function<void(CallAnswer)> handler)
      : resolver_(context), stream_(std::move(stream)), call_(std::move(call)), handler_(std::move(handler)) {
    parser_.body_limit(call_.most_bytes);
  }

  void run() {
    resolver_.async_resolve(
        call_.host, call_.port, [self = this->shared_from_this()](error_code error, const auto& found) {
          if (error) return self->fail("its name has no address", error);
          self->limit();
          beast::get_lowest_layer(self->stream_).async_connect(found, [self](error_code problem, const Tcp::endpoint&) {
            if (problem) return self->fail("it cannot be reached", problem);
            self->shake_hands();
          });
        });
  }

 private:
  void limit() { beast::get_lowest_layer(stream_).expires_after(call_.limit); }

  void shake_hands() {
    if constexpr (std::is_same_v<Stream, Tls>) {
      limit();
      SSL_ctrl(stream_.native_handle(), SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name, call_.host.data());
      stream_.async_handshake(asio::ssl::stream_base::client, [self = this->shared_from_this()](error_code error) {
        if (error) return self->fail("TLS", error);
        self->write();
      });
    } else {
      write();
    }
  }

  void write() try {
    limit();
    request_.version(11);
    request_.method_string(call_.method);
    request_.target(call_.target);
    request_.set(wire::field::host, call_.host + ":" + call_.port);
    request_.set(wire::field::user_agent, "iotcloud");
    if (!call_.content_type.empty()) request_.set(wire::field::content_type, call_.content_type);
    if (!call_.authorization.empty()) request_.set(wire::field::authorization, call_.authorization);
    request_.keep_alive(false);
    request_.body() = std::move(call_.body);
    request_.prepare_payload();
    wire::async_write(stream_, request_, [self = this->shared_from_this()](error_code error, std::size_t) {
      if (error) return self->fail("it took no request", error);
      self->read();
    });
  } catch (const std::exception& e) {  // Beast takes no field of 64 KiB
    fail(std::string("no request can be made: ") + e.what());
  }

  void read() {
    limit();
    if (call_.method == "HEAD") parser_.skip(true);
    wire::async_read_header(
        stream_, buffer_, parser_, [self = this->shared_from_this()](error_code error, std::size_t) {
          if (!error && self->call_.method != "HEAD" && is_too_long(self->parser_, self->call_.most_bytes))
            error = wire::error::body_limit;
          if (error) return self->fail("its answer", error);
          self->read_body();
        });
  }

  void read_body() {
    wire::async_read(stream_, buffer_, parser_, [self = this->shared_from_this()](error_code error, std::size_t) {
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
  Stream stream_;
  Call call_;
  const std::function<void(CallAnswer)> handler_;
  beast::flat_buffer buffer_;
  wire::request<wire::string_body> request_;
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
    if (server_tls) {
      std::make_shared<Session<Tls>>(Tls(Plain(std::move(socket)), *server_tls), server, peer)->run();
    } else {
      std::make_shared<Session<Plain>>(Plain(std::move(socket)), server, peer)->run();
    }
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
  if (!call.tls) {
    const auto calling =
        std::make_shared<Calling<Plain>>(impl_->context, Plain(impl_->context), std::move(call), std::move(handler));
    asio::post(impl_->context, [calling] { calling->run(); });
    return;
  }
  try {
    asio::ssl::context tls(asio::ssl::context::tls_client);  // the stream keeps a reference of its own
    SSL_CTX_set_min_proto_version(tls.native_handle(), TLS1_2_VERSION);
    if (call.ca.empty()) {
      tls.set_default_verify_paths();
    } else {
      tls.load_verify_file(call.ca);
    }
    tls.set_verify_mode(asio::ssl::verify_peer);
    Tls stream(Plain(impl_->context), tls);
    stream.set_verify_callback(asio::ssl::host_name_verification(call.host));
    const auto calling =
        std::make_shared<Calling<Tls>>(impl_->context, std::move(stream), std::move(call), std::move(handler));
    asio::post(impl_->context, [calling] { calling->run(); });
  } catch (const boost::system::system_error& e) {
    throw std::runtime_error(std::string("TLS: ") + e.what());
  }
}

}  // namespace iotcloud::drivers::http
