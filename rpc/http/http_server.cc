#include <algorithm>
#include <atomic>
#include <charconv>
#include <deque>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string_view>
#include <thread>
#include <vector>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/status.hpp>
#include <boost/beast/http/string_body.hpp>
#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/http/http_line.h>
#include <iotcloud/rpc/http/http_message.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/rpc/http/http_site.h>
#include <iotcloud/rpc/http/page_guard.h>
#include <iotcloud/rpc/http/page_turns.h>
#include <iotcloud/rpc/peer_user.h>
#include <iotcloud/rpc/refusal_log.h>

namespace iotcloud::rpc {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using boost::system::error_code;
using tcp = asio::ip::tcp;

constexpr std::size_t most_connections = 64, most_connections_of_site = 256;
constexpr std::uint32_t longest_head = 8192;
constexpr std::uint64_t longest_body = 65'536;  ///< of a request to a site
/// Of a stream, that its reader has not taken.
constexpr std::size_t most_untaken = std::size_t{16} << 20U;
/// The most time for a whole request, from when the server waits for it, however slowly its bytes come; and the most
/// time until the client has taken the answer.
constexpr std::chrono::seconds request_limit{15}, answer_limit{15};
/// The longest time for which a reader waits for its turn (page_turns.h).
constexpr std::chrono::seconds turn_limit{5};
/// How long nothing is accepted when descriptors or memory have run out.
constexpr std::chrono::milliseconds accept_pause{100};

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

template <typename Request = HttpRequest>
Request parse_target(std::string_view target) {
  Request request;
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
  const auto request = parse_target(target);
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

class HttpConnection;

/// The server's open connections, in the order in which they began their present step, which is to wait for a request
/// or to send an answer. Used by the server's thread.
using HttpConnections = std::list<HttpConnection*>;

/// The way from any thread to a server's own, as long as there is a server.
class Gate {
 public:
  explicit Gate(asio::io_context& io) : io_(&io) {}
  void post(std::function<void()> task) IOTCLOUD_EXCLUDES(mutex_) {
    const config::MutexLock lock(mutex_);
    if (io_ != nullptr) asio::post(*io_, std::move(task));
  }
  void close() IOTCLOUD_EXCLUDES(mutex_) {
    const config::MutexLock lock(mutex_);
    io_ = nullptr;
  }

 private:
  config::Mutex mutex_;
  asio::io_context* io_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// What all connections of a server use.
struct Shared {
  const Pages& pages;
  const HttpSite& site;  ///< empty: there are pages
  const std::shared_ptr<Gate>& gate;
  const PageGuard& guard;
  const config::Clock& clock;
  PageTurns turns{clock};
  HttpConnections connections{};
  std::function<void(const std::string& reason, const std::string& text)> refused{};
};

/// Who is at the other end, until a certificate says it: a user of this machine, or what comes from one host. All
/// addresses of loopback are this host.
std::string stranger_at(tcp::socket& socket) {
  if (const auto user = peer_user(socket.native_handle())) return fmt::format("user {}", *user);
  error_code ignored;
  const auto address = socket.remote_endpoint(ignored).address();
  return address.is_loopback() ? "localhost" : address.to_string();
}

/// One connection's place among all.
class HttpConnection {
 public:
  HttpConnection(Shared& shared, std::string reader)
      : shared_(shared),
        reader_(std::move(reader)),
        place_(shared.connections.insert(shared.connections.end(), this)) {}
  virtual ~HttpConnection() {
    if (open_) shared_.connections.erase(place_);
  }
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;

  void cut() {
    if (!open_) return;
    const auto last = std::move(kept_);
    shared_.connections.erase(place_);
    open_ = false;
    close();
  }
  /// Takes what keeps a connection that waits for its site; it may be the last that does.
  std::shared_ptr<HttpConnection> release() { return std::move(kept_); }
  /// Why the reader's certificate counts no longer; empty: it counts, or there is none.
  virtual std::string distrust(const security::TlsContext& tls) = 0;
  /// Who shares limits: the holders of one certificate, the processes of one user, or what comes from one host.
  const std::string& reader() const { return reader_; }

 protected:
  void set_reader(std::string reader) { reader_ = std::move(reader); }
  virtual void close() = 0;
  void begin() { shared_.connections.splice(shared_.connections.end(), shared_.connections, place_); }
  bool is_open() const { return open_; }  ///< false: it was cut, and ends when its operation has
  void keep(std::shared_ptr<HttpConnection> self) { kept_ = std::move(self); }

  Shared& shared_;

 private:
  std::shared_ptr<HttpConnection> kept_;  ///< this, while no operation is pending because the site is to do something
  std::string reader_;
  const HttpConnections::iterator place_;
  bool open_ = true;
};

/// How a stream stands, for its connection and those who send.
struct StreamState {
  std::atomic<std::size_t> untaken{0};
  std::atomic<bool> open{true};
};

/// A stream of a connection.
template <typename Connection>
class SiteStream final : public HttpStream {
 public:
  SiteStream(std::shared_ptr<Gate> gate, std::weak_ptr<Connection> connection, std::shared_ptr<StreamState> state)
      : gate_(std::move(gate)), connection_(std::move(connection)), state_(std::move(state)) {}
  ~SiteStream() override { end(); }
  SiteStream(const SiteStream&) = delete;
  SiteStream& operator=(const SiteStream&) = delete;

  bool send(std::shared_ptr<const std::string> piece) override {
    if (!state_->open) return false;
    if (state_->untaken.fetch_add(piece->size()) + piece->size() > most_untaken) {
      state_->open = false;
      gate_->post([connection = connection_] {
        if (const auto self = connection.lock()) self->fell_behind();
      });
      return false;
    }
    gate_->post([connection = connection_, piece = std::move(piece)]() mutable {
      if (const auto self = connection.lock()) self->send_piece(std::move(piece));
    });
    return true;
  }
  void end() override {
    if (!state_->open.exchange(false)) return;
    gate_->post([connection = connection_] {
      if (const auto self = connection.lock()) self->end_stream();
    });
  }

 private:
  const std::shared_ptr<Gate> gate_;
  const std::weak_ptr<Connection> connection_;
  const std::shared_ptr<StreamState> state_;
};

/// The reply to a request of a connection.
template <typename Connection>
class SiteReply final : public HttpReply {
 public:
  SiteReply(std::shared_ptr<Gate> gate, std::weak_ptr<Connection> connection)
      : gate_(std::move(gate)), connection_(std::move(connection)) {}
  ~SiteReply() override { answer({500, "text/plain", "nobody has answered\n"}); }
  SiteReply(const SiteReply&) = delete;
  SiteReply& operator=(const SiteReply&) = delete;

  void answer(HttpAnswer answer) override {
    if (given_.exchange(true)) return;
    gate_->post([connection = connection_, answer = std::move(answer)]() mutable {
      if (const auto self = connection.lock()) self->answered(std::move(answer));
    });
  }
  std::shared_ptr<HttpStream> stream(HttpAnswer head) override {
    auto state = std::make_shared<StreamState>();
    auto made = std::make_shared<SiteStream<Connection>>(gate_, connection_, state);
    if (given_.exchange(true)) return made;
    gate_->post([connection = connection_, head = std::move(head), state = std::move(state)]() mutable {
      if (const auto self = connection.lock()) self->begin_stream(std::move(head), std::move(state));
    });
    return made;
  }

 private:
  const std::shared_ptr<Gate> gate_;
  const std::weak_ptr<Connection> connection_;
  std::atomic<bool> given_{false};
};

/// "HTTP/1.1 200 OK" with the end of the line.
std::string status_line(int status, unsigned version) {
  const auto reason = http::obsolete_reason(static_cast<http::status>(status));
  return fmt::format("HTTP/{}.{} {} {}\r\n", version / 10, version % 10, status, reason.to_string());
}

/// A connection with its conversation. Lives as long as one of its operations is pending.
class HttpConversation final : public HttpConnection, public std::enable_shared_from_this<HttpConversation> {
 public:
  /// \param tls null: without TLS
  HttpConversation(Shared& shared, tcp::socket socket, ssl_ctx_st* tls)
      : HttpConnection(shared, stranger_at(socket)), line_(std::move(socket), tls) {}
  ~HttpConversation() override {
    if (state_) state_->open = false;
  }
  HttpConversation(const HttpConversation&) = delete;
  HttpConversation& operator=(const HttpConversation&) = delete;

  std::string distrust(const security::TlsContext& tls) override {
    return line_.tls() == nullptr ? "" : tls.distrust(security::shown_certificate(line_.tls()));
  }

  void start() {
    if (line_.tls() == nullptr) return read();
    begin();
    line_.expires_after(request_limit);
    line_.shake_hands(HttpLine::Side::server, [self = shared_from_this()](error_code error, std::size_t) {
      if (!self->is_open()) return;
      if (!error) return self->greet();
      self->shared_.refused("tls", "a reader cannot be talked to by TLS: " + error.message());
    });
  }

  /// The site has an answer.
  void answered(HttpAnswer made) {
    if (!is_open()) return;
    const auto self = release();
    send(std::move(made));
  }

  /// The site has begun an answer without end, which ends with the connection.
  void begin_stream(HttpAnswer head, std::shared_ptr<StreamState> state) {
    if (!is_open()) return;
    state_ = std::move(state);
    auto text = status_line(head.status, 11) +
                fmt::format("Server: iotcloud\r\nConnection: close\r\nContent-Type: {}\r\n", head.content_type);
    for (const auto& [name, value] : head.headers) text += fmt::format("{}: {}\r\n", name, value);
    text += "\r\n" + head.body;
    state_->untaken += text.size();
    pieces_.push_front(std::make_shared<const std::string>(std::move(text)));
    write_piece();
  }

  /// What other threads post may come before what this thread has posted: pieces wait for the beginning.
  void send_piece(std::shared_ptr<const std::string> piece) {
    if (!is_open()) return;
    pieces_.push_back(std::move(piece));
    if (state_ && pieces_.size() == 1) write_piece();
  }

  void end_stream() {
    if (!is_open()) return;
    ending_ = true;
    if (state_ && pieces_.empty()) {
      const auto self = release();
      end();
    }
  }

  void fell_behind() {
    if (!is_open()) return;
    shared_.refused("behind", reader() + " does not take what it is sent");
    cut();
  }

 private:
  void close() override { line_.close(); }

  /// The handshake has ended.
  void greet() {
    if (std::string subject = certificate(); !subject.empty()) set_reader(std::move(subject));
    read();
  }

  void read() {
    begin();
    parser_.emplace();
    parser_->header_limit(longest_head);
    parser_->body_limit(shared_.site ? longest_body : 0);
    line_.expires_after(request_limit);
    read_message(line_, buffer_, *parser_, HttpPart::whole, [self = shared_from_this()](error_code error) {
      if (!self->is_open()) return;
      if (!error && self->shared_.site) return self->hand_over();
      if (!error) return self->await_turn(std::chrono::steady_clock::now() + turn_limit);
      if (is_no_http(error)) self->shared_.refused("request", "a reader's request is no HTTP: " + error.message());
    });
  }

  /// Whether a request was read that breaks the protocol or its limits, and not just ended or late.
  static bool is_no_http(const error_code& error) {
    return error.category() == http::make_error_code(http::error::bad_target).category() &&
           error != http::error::end_of_stream && error != http::error::partial_message;
  }

  /// Answers when it is the reader's turn; who is still waiting then is told to ask for less.
  void await_turn(std::chrono::steady_clock::time_point end) {
    const auto wait = shared_.turns.wait(reader());
    if (wait <= wait.zero()) return write();
    if (std::chrono::steady_clock::now() + wait > end) {
      shared_.refused("rate", reader() + " asks for too much");
      return write(HttpAnswer{429, "text/plain", reader() + " asks for too much; try again later\n"});
    }
    turn_.expires_after(wait);
    turn_.async_wait([self = shared_from_this(), end](error_code) {
      if (self->is_open()) self->await_turn(end);  // others of this reader may have had their turns meanwhile
    });
  }

  /// The refusal of a request that its token does not allow; nullopt: it does. A connection's token is looked at once,
  /// because that takes time.
  std::optional<HttpAnswer> refusal() {
    if (!shared_.guard.asks_for_token()) return std::nullopt;
    const auto header = parser_->get()[http::field::authorization];
    const std::string shown(header.data(), header.size());
    if (!holder_ || shown != shown_) {
      if (!shared_.guard.may_try(shown, reader())) {
        shared_.refused("token_rate", reader() + " tries too many tokens");
        return HttpAnswer{429, "text/plain", reader() + " tries too many tokens; try again later\n"};
      }
      holder_ = shared_.guard.reader(shown, certificate());
      shown_ = shown;
    }
    if (holder_ && shared_.guard.still_may(*holder_)) return std::nullopt;
    shared_.refused("token", "a reader shows no token, or one that is nobody's");
    return HttpAnswer{401,
                      "text/plain",
                      "these pages ask for a token: send the header Authorization: Bearer TOKEN\n",
                      {{"WWW-Authenticate", "Bearer"}}};
  }

  std::string certificate() { return line_.tls() == nullptr ? "" : security::peer_subject(line_.tls()); }

  HttpAnswer answer() {
    if (auto refused = refusal()) {
      keep_alive_ = false;  // so that each further token that somebody tries costs a handshake
      return *std::move(refused);
    }
    const auto target = parser_->get().target();
    const auto started = shared_.clock.now();
    HttpAnswer made = answer_to(shared_.pages, {target.data(), target.size()});
    // Without what the token took, of which the tries are limited.
    page_took_ = shared_.clock.now() - started;
    return made;
  }

  /// Gives the request to the site. Until the site answers no operation is pending.
  void hand_over() {
    begin();
    line_.expires_never();
    const auto& got = parser_->get();
    auto request = parse_target<SiteRequest>({got.target().data(), got.target().size()});
    head_ = got.method() == http::verb::head;
    request.method = head_ ? "GET" : got.method_string().to_string();
    for (const auto& field : got) {
      auto name = field.name_string().to_string();
      std::transform(name.begin(), name.end(), name.begin(),
                     [](char c) { return static_cast<char>(c >= 'A' && c <= 'Z' ? c + ('a' - 'A') : c); });
      request.headers[name] = field.value().to_string();
    }
    request.body = got.body();
    error_code ignored;
    auto& socket = line_.socket();
    const auto from = socket.remote_endpoint(ignored);
    request.address = fmt::format("{}:{}", from.address().to_string(), from.port());
    request.certificate = certificate();
    request.user = peer_user(socket.native_handle());
    keep(shared_from_this());
    const auto reply = std::make_shared<SiteReply<HttpConversation>>(shared_.gate, weak_from_this());
    try {
      shared_.site(std::move(request), reply);
    } catch (const std::exception& error) {
      reply->answer({500, "text/plain", std::string(error.what()) + "\n"});
    }
  }

  void write_piece() {
    begin();
    line_.expires_after(answer_limit);
    line_.write(asio::buffer(*pieces_.front()), [self = shared_from_this()](error_code error, std::size_t) {
      if (!self->is_open()) return;
      if (error) return self->cut();
      self->state_->untaken -= self->pieces_.front()->size();
      self->pieces_.pop_front();
      if (!self->pieces_.empty()) return self->write_piece();
      if (!self->ending_) return;
      const auto last = self->release();
      self->end();
    });
  }

  /// \param refused the answer instead of a page
  void write(std::optional<HttpAnswer> refused = std::nullopt) {
    page_took_ = {};
    const auto& request = parser_->get();
    begin();
    keep_alive_ = request.keep_alive() && !refused;
    head_ = request.method() == http::verb::head;
    HttpAnswer made{405, "", "", {{"Allow", "GET, HEAD"}}};
    if (head_ || request.method() == http::verb::get) made = refused ? *std::move(refused) : answer();
    shared_.turns.took(reader(), page_took_);
    write_answer(made);
  }

  /// Sends what the site answers.
  void send(HttpAnswer made) {
    begin();
    keep_alive_ = parser_->get().keep_alive();
    write_answer(made);
  }

  /// In the version of the request; each version says the other of whether the connection stays open.
  void write_answer(const HttpAnswer& made) {
    const unsigned version = parser_->get().version();
    answer_ = status_line(made.status, version);
    if (keep_alive_ != (version >= 11)) answer_ += keep_alive_ ? "Connection: keep-alive\r\n" : "Connection: close\r\n";
    answer_ += "Server: iotcloud\r\n";
    if (!made.content_type.empty()) answer_ += fmt::format("Content-Type: {}\r\n", made.content_type);
    for (const auto& [name, value] : made.headers) answer_ += fmt::format("{}: {}\r\n", name, value);
    answer_ += fmt::format("Content-Length: {}\r\n\r\n", made.body.size());
    if (!head_) answer_ += made.body;
    line_.expires_after(answer_limit);
    line_.write(asio::buffer(answer_), [self = shared_from_this()](error_code error, std::size_t) {
      if (error || !self->is_open()) return;
      if (self->keep_alive_) return self->read();
      self->end();
    });
  }

  void end() {
    if (line_.tls() != nullptr) return line_.say_goodbye([self = shared_from_this()](error_code, std::size_t) {});
    error_code ignored;
    line_.socket().shutdown(tcp::socket::shutdown_send, ignored);
  }

  HttpLine line_;
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::string_body>> parser_;
  std::string answer_;  ///< that is being sent
  std::optional<security::TokenEntry> holder_;
  std::string shown_;                             ///< the header by which `holder_` was found
  config::Clock::Instant::duration page_took_{};  ///< of the present answer
  asio::steady_timer turn_{line_.socket().get_executor()};
  bool keep_alive_ = false;                                ///< after the present answer the connection goes on
  bool head_ = false;                                      ///< of the present answer only the head is sent
  std::shared_ptr<StreamState> state_;                     ///< null: no stream has begun
  std::deque<std::shared_ptr<const std::string>> pieces_;  ///< that are still to be sent; the first is on its way
  bool ending_ = false;                                    ///< the stream ends behind these
};

}  // namespace

HttpRequest read_target(const std::string& target) {
  return parse_target(target);
}

struct HttpServer::Impl {
  Impl(const PageSettings& settings, Pages handlers, HttpSite whole, const config::Clock& clock)
      : pages(std::move(handlers)),
        site(std::move(whole)),
        guard(settings, clock, site ? PageGuard::Of::site : PageGuard::Of::pages),
        host(HttpAddress(settings.address).host),
        look_period(settings.look_period),
        shared{pages, site, gate, guard, clock},
        acceptor(io) {
    shared.refused = [this](const auto& reason, const auto& text) { refused(reason, text); };
    tcp::resolver resolver(io);
    const auto found = resolver.resolve(host, HttpAddress(settings.address).port,
                                        tcp::resolver::passive | tcp::resolver::numeric_service);
    const tcp::endpoint endpoint = *found.begin();
    acceptor.open(endpoint.protocol());
    acceptor.set_option(asio::socket_base::reuse_address(true));
    acceptor.bind(endpoint);
    acceptor.listen();
    bound_port = acceptor.local_endpoint().port();
    accept();
    look();
    thread = std::thread([this] { io.run(); });
  }
  ~Impl() {
    gate->close();
    io.stop();
    if (thread.joinable()) thread.join();
    std::vector<std::shared_ptr<HttpConnection>> waiting;  // which wait for the site
    for (HttpConnection* const connection : shared.connections) waiting.push_back(connection->release());
  }

  void accept() {
    acceptor.async_accept([this](error_code error, tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      if (!error) {
        make_room();
        serve(std::move(socket));
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

  void serve(tcp::socket socket) {
    const auto tls = guard.tls().context();
    std::make_shared<HttpConversation>(shared, std::move(socket), tls ? tls->get() : nullptr)->start();
  }

  /// Reads TLS files that were replaced, cuts readers whose certificate counts no longer, and looks again later.
  void look() {
    if (const auto problem = guard.tls().look(); !problem.empty()) {
      logger.error("the pages at port {} go on with the certificate that they had: {}", bound_port, problem);
    }
    const auto tls = guard.tls().context();
    if (!tls) return;
    const std::vector<HttpConnection*> open(shared.connections.begin(), shared.connections.end());
    for (HttpConnection* const connection : open) {
      const std::string why = connection->distrust(*tls);
      if (why.empty()) continue;
      refused("revoked", "a reader is cut off: its certificate is " + why);
      connection->cut();
    }
    looking.expires_after(look_period);
    looking.async_wait([this](error_code ended) {
      if (!ended) look();
    });
  }

  /// If there are too many connections, cuts one of the reader that has the most: the one that has been the longest at
  /// its request, or at taking its answer. So who asks and reads at once, such as a probe of /healthz, is always
  /// answered, and no reader keeps others away, however fast it asks.
  void make_room() {
    const HttpConnections& connections = shared.connections;
    if (connections.size() < (site ? most_connections_of_site : most_connections)) return;
    std::map<std::string, std::size_t> counts;
    for (const auto* const one : connections) ++counts[one->reader()];
    const auto most = std::max_element(counts.begin(), counts.end(),
                                       [](const auto& one, const auto& other) { return one.second < other.second; });
    refused("connections", fmt::format("there are {} connections already; of {}, who has {} of them, the one that has "
                                       "been the longest at its request, or at taking its answer, is cut off",
                                       connections.size(), most->first, most->second));
    const auto of_it = std::find_if(connections.begin(), connections.end(),
                                    [&](const auto* one) { return one->reader() == most->first; });
    (*of_it)->cut();
  }

  void refused(const std::string& reason, const std::string& text) {
    log.refused(reason, "the pages at port " + std::to_string(bound_port) + ": " + text);
    config::process_metrics()
        .counter("iotcloud_http_refused_total", "Connections that a daemon's HTTP server refused or cut off",
                 {{"reason", reason}})
        .add();
  }

  const Pages pages;
  const HttpSite site;
  PageGuard guard;
  const std::string host;
  const std::chrono::milliseconds look_period;
  std::uint16_t bound_port = 0;
  const config::Logger logger{"http"};
  RefusalLog log{logger};
  /// Declared before `io`, whose destructor destroys connections; the gate only knows where `io` will be.
  const std::shared_ptr<Gate> gate = std::make_shared<Gate>(io);
  Shared shared;
  asio::io_context io{1};
  tcp::acceptor acceptor;
  asio::steady_timer pause{io}, looking{io};
  std::thread thread;
};

HttpServer::HttpServer(const PageSettings& settings, std::map<std::string, HttpHandler> pages,
                       const config::Clock& clock) {
  serve(settings, std::move(pages), {}, clock);
}

HttpServer::HttpServer(const PageSettings& settings, HttpSite site) {
  serve(settings, {}, std::move(site), config::system_clock());
}

void HttpServer::serve(const PageSettings& settings, std::map<std::string, HttpHandler> pages, HttpSite site,
                       const config::Clock& clock) {
  try {
    impl_ = std::make_unique<Impl>(settings, std::move(pages), std::move(site), clock);
  } catch (const std::exception& e) {
    throw config::Error("pages cannot be served at " + settings.address + " (" + e.what() +
                        "); is the address of the form host:port, and the port free?");
  }
}

HttpServer::~HttpServer() = default;

std::string HttpServer::address() const {
  const bool six = impl_->host.find(':') != std::string::npos;
  return (six ? "[" + impl_->host + "]" : impl_->host) + ":" + std::to_string(impl_->bound_port);
}

void HttpServer::reload() {
  impl_->guard.reload();
  asio::post(impl_->io, [impl = impl_.get()] { impl->look(); });
}

}  // namespace iotcloud::rpc
