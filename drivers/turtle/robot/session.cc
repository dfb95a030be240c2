#include <algorithm>
#include <array>
#include <deque>
#include <utility>
#include <vector>

#include <boost/asio/buffer.hpp>
#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>

#include <iotcloud/drivers/turtle/robot/session.h>

namespace iotcloud::drivers::turtle::robot {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;
using std::chrono::milliseconds;

namespace {

constexpr milliseconds least_silence{20}, most_silence{60'000};
constexpr int ticks_of_silence = 4;

}  // namespace

/// The state of a session. Its asynchronous operations share it, so it lives until the last of them has returned.
struct Session::State : std::enable_shared_from_this<State> {
  State(asio::io_context& loop, const SessionOptions& session_options, Handlers session_handlers)
      : options(session_options),
        handlers(std::move(session_handlers)),
        resolver(loop),
        socket(loop),
        deadline(loop),
        ticks(loop),
        beats(loop),
        nonce(random_nonce()) {}

  void begin() {
    deadline.expires_after(options.handshake);
    deadline.async_wait([self = shared_from_this()](const error_code& error) {
      // It may have answered while this call was waiting for its turn.
      if (!error && !self->open) self->end("it did not answer");
    });
    resolver.async_resolve(
        options.host, options.port,
        [self = shared_from_this()](const error_code& error, const tcp::resolver::results_type& found) {
          if (error) return self->end(error.message());
          self->connect(found);
        });
  }

  void connect(const tcp::resolver::results_type& found) {
    asio::async_connect(socket, found, [self = shared_from_this()](const error_code& error, const tcp::endpoint&) {
      if (error) return self->end(error.message());
      error_code ignored;
      self->socket.set_option(tcp::no_delay(true), ignored);
      Hello hello;
      hello.silence_ms = static_cast<std::uint32_t>(self->options.silence.count());
      hello.nonce = self->nonce;
      hello.name = self->options.name;
      self->send(write_hello(hello), {});
      self->read();
    });
  }

  void read() {
    socket.async_read_some(
        asio::buffer(buffer), [self = shared_from_this()](const error_code& error, std::size_t count) {
          if (error) return self->end(error == asio::error::eof ? "it closed the connection" : error.message());
          self->silent_ticks = 0;
          auto bytes = std::span<const std::byte>(self->buffer.data(), count);
          try {
            while (!self->ended) {
              const auto message = self->reader.take(bytes);
              if (!message) break;
              self->receive(*message);
            }
          } catch (const ProtocolError& e) {
            return self->end(e.what());
          }
          if (!self->ended) self->read();
        });
  }

  void receive(const Incoming& message) {
    if (message.kind == Kind::refused) return end("it refuses: " + read_refused(message));
    if (open) {
      const auto on_message = handlers.on_message;  // a copy: the callback may destroy the session
      return on_message(message);
    }
    if (message.kind != Kind::challenge) throw ProtocolError("this is no turtle driver");
    const Challenge challenge = read_challenge(message);
    if (!same_proof(challenge.proof, make_proof(Side::driver, options.token, nonce, challenge.nonce))) {
      throw ProtocolError("its token is not this robot's");
    }
    open = true;
    deadline.cancel();
    reader.set_limit(most_to_agent);
    send(write_proof(make_proof(Side::agent, options.token, nonce, challenge.nonce)), {});
    keep_beating(std::clamp(milliseconds(challenge.silence_ms), least_silence, most_silence) / ticks_of_silence);
    watch_silence();
    const auto on_open = handlers.on_open;
    on_open();
  }

  void keep_beating(milliseconds period) {
    beats.expires_after(period);
    beats.async_wait([self = shared_from_this(), period](const error_code& error) {
      if (error || self->ended) return;
      // While other messages wait no heartbeat is needed: their bytes are a sign of life.
      if (self->outgoing.empty()) self->send(write_bare(Kind::alive), {});
      self->keep_beating(period);
    });
  }

  void watch_silence() {
    ticks.expires_after(options.silence / ticks_of_silence);
    ticks.async_wait([self = shared_from_this()](const error_code& error) {
      if (error || self->ended) return;
      if (++self->silent_ticks >= ticks_of_silence) return self->end("nothing was heard from it for too long");
      self->watch_silence();
    });
  }

  void send(std::string head, Payload body) {
    if (ended) return;
    outgoing.emplace_back(std::move(head), std::move(body));
    if (outgoing.size() == 1) write();
  }

  void write() {
    const auto& [head, body] = outgoing.front();
    const std::array<asio::const_buffer, 2> buffers{asio::buffer(head), asio::buffer(body.data(), body.size())};
    asio::async_write(socket, buffers, [self = shared_from_this()](const error_code& error, std::size_t) {
      // The reader reports the end of the connection, after the other side's last message.
      if (error || self->ended) return;
      self->outgoing.pop_front();
      if (!self->outgoing.empty()) self->write();
    });
  }

  void end(const std::string& reason) {
    if (std::exchange(ended, true)) return;
    error_code ignored;
    resolver.cancel();
    socket.close(ignored);
    deadline.cancel();
    ticks.cancel();
    beats.cancel();
    const auto on_end = std::move(handlers.on_end);
    handlers = {};
    if (on_end) on_end(reason);
  }

  const SessionOptions options;
  Handlers handlers;
  tcp::resolver resolver;
  tcp::socket socket;
  asio::steady_timer deadline, ticks, beats;
  const Nonce nonce;
  MessageReader reader{most_before_proof};
  std::array<std::byte, 4096> buffer{};
  std::deque<std::pair<std::string, Payload>> outgoing;
  int silent_ticks = 0;
  bool open = false, ended = false;
};

Session::Session(asio::io_context& loop, const SessionOptions& options, Handlers handlers)
    : state_(std::make_shared<State>(loop, options, std::move(handlers))) {
  state_->begin();
}

Session::~Session() {
  state_->handlers = {};
  state_->end("");
}

void Session::send(std::string head, Payload body) {
  state_->send(std::move(head), std::move(body));
}

}  // namespace iotcloud::drivers::turtle::robot
