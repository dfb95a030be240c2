#include <array>
#include <cerrno>
#include <cstring>
#include <memory>
#include <utility>

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/turtle/robot/connection.h>

namespace iotcloud::drivers::turtle::robot {

namespace {

constexpr std::size_t most_unsent = 16'384;
constexpr int ticks_of_silence = 4;
constexpr int reads_at_once = 16;  // then other handlers of the event thread have their turn

}  // namespace

Connection::Connection(DriverContext& context, int socket, std::chrono::milliseconds silence, Handlers handlers)
    : context_(context), socket_(socket), handlers_(std::move(handlers)) {
  const int on = 1;
  setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);  // sends a command at once
  readable_ = context_.on_readable(socket_, [this] { read(); });
  watch_silence(silence);
}

Connection::~Connection() {
  *alive_ = false;
  context_.stop(readable_);
  if (ticks_) context_.stop(*ticks_);
  if (writable_) context_.stop(*writable_);
  if (beats_) context_.stop(*beats_);
  close(socket_);
}

void Connection::establish(std::size_t most_bytes, std::chrono::milliseconds silence,
                           std::chrono::milliseconds silence_of_peer, Handlers handlers) {
  reader_.set_limit(most_bytes);
  handlers_ = std::move(handlers);
  watch_silence(silence);
  beats_ = context_.every(silence_of_peer / ticks_of_silence, [this] { send(write_bare(Kind::alive)); });
}

void Connection::watch_silence(std::chrono::milliseconds silence) {
  if (ticks_) context_.stop(*ticks_);
  ticks_ = context_.every(silence / ticks_of_silence, [this] { tick(); });
}

void Connection::read() {
  std::array<std::byte, 65536> buffer;
  for (int i = 0; i < reads_at_once; ++i) {
    const ssize_t count = recv(socket_, buffer.data(), buffer.size(), 0);
    if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) return;
    if (count <= 0) return end(count == 0 ? "it was closed" : std::strerror(errno));
    silent_ticks_ = 0;
    auto bytes = std::span<const std::byte>(buffer.data(), static_cast<std::size_t>(count));
    const auto alive = alive_;
    try {
      while (const auto message = reader_.take(bytes)) {
        const auto on_message = handlers_.on_message;  // a copy: the callback may replace it, or destroy this object
        on_message(*message);
        if (!*alive) return;
      }
    } catch (const ProtocolError& e) {
      if (*alive) end(e.what());
      return;
    }
  }
}

void Connection::send(const std::string& message) {
  if (!*alive_) return;
  unsent_ += message;
  if (!writable_) write();
}

void Connection::write() {
  const ssize_t count = ::send(socket_, unsent_.data(), unsent_.size(), MSG_NOSIGNAL);
  if (count > 0) unsent_.erase(0, static_cast<std::size_t>(count));
  // reading reports an error too; a peer that never reads is noticed only here
  if (unsent_.empty() || unsent_.size() > most_unsent) {
    if (writable_) context_.stop(*writable_);
    writable_.reset();
    if (!unsent_.empty()) shutdown(socket_, SHUT_RDWR);
  } else if (!writable_) {
    writable_ = context_.on_writable(socket_, [this] { write(); });
  }
}

void Connection::tick() {
  if (++silent_ticks_ >= ticks_of_silence) end("nothing was heard from it for too long");
}

void Connection::end(const std::string& reason) {
  if (!std::exchange(*alive_, false)) return;
  const auto on_end = handlers_.on_end;  // a copy: the callback may destroy this object
  on_end(reason);
}

}  // namespace iotcloud::drivers::turtle::robot
