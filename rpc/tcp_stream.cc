#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/rpc/peer_user.h>
#include <iotcloud/rpc/tcp_stream.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

using Kind = TcpStreamError::Kind;

namespace {

int descriptor_of(BIO* bio) {
  return static_cast<int>(reinterpret_cast<std::intptr_t>(BIO_get_data(bio)));
}

/// OpenSSL's own socket BIO raises SIGPIPE, which would end the process.
int bio_write(BIO* bio, const char* data, int size) {
  BIO_clear_retry_flags(bio);
  const auto sent = send(descriptor_of(bio), data, static_cast<std::size_t>(size), MSG_NOSIGNAL);
  if (sent < 0 && (errno == EAGAIN || errno == EINTR)) BIO_set_retry_write(bio);
  return static_cast<int>(sent);
}

int bio_read(BIO* bio, char* data, int size) {
  BIO_clear_retry_flags(bio);
  const auto got = recv(descriptor_of(bio), data, static_cast<std::size_t>(size), 0);
  if (got < 0 && (errno == EAGAIN || errno == EINTR)) BIO_set_retry_read(bio);
  if (got == 0) errno = 0;  // after_tls() takes this for the end of the stream
  return static_cast<int>(got);
}

long bio_control(BIO*, int command, long, void*) {
  return command == BIO_CTRL_FLUSH ? 1 : 0;
}

BIO_METHOD* bio_method() {
  static BIO_METHOD* const method = [] {
    auto* const made = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "iotcloud stream");
    BIO_meth_set_write(made, bio_write);
    BIO_meth_set_read(made, bio_read);
    BIO_meth_set_ctrl(made, bio_control);
    return made;
  }();
  return method;
}

/// The error for a failed read or write. A peer that disconnected is reported as a reset on some systems.
TcpStreamError error_of(int problem) {
  if (problem == ECONNRESET || problem == EPIPE) return {Kind::ended, "the connection was closed"};
  return {Kind::broken, std::strerror(problem)};
}

/// Keep-alive: a peer that vanished silently is noticed within two minutes.
void set_options(int descriptor) {
  const auto set = [&](int level, int option, int value) {
    setsockopt(descriptor, level, option, &value, sizeof value);
  };
  set(IPPROTO_TCP, TCP_NODELAY, 1);
  set(SOL_SOCKET, SO_KEEPALIVE, 1);
  set(IPPROTO_TCP, TCP_KEEPIDLE, 60);
  set(IPPROTO_TCP, TCP_KEEPINTVL, 15);
  set(IPPROTO_TCP, TCP_KEEPCNT, 4);
  fcntl(descriptor, F_SETFL, fcntl(descriptor, F_GETFL) | O_NONBLOCK);
}

}  // namespace

struct TcpStream::Tls {
  explicit Tls(SSL* s) : ssl(s) {}
  ~Tls() {
    if (usable) {
      SSL_shutdown(ssl);  // sends close_notify, without waiting for the peer's
      ERR_clear_error();
    }
    SSL_free(ssl);
  }
  Tls(const Tls&) = delete;
  Tls& operator=(const Tls&) = delete;

  SSL* const ssl;
  bool usable = false;  ///< true from the handshake until the first error
};

TcpStream::TcpStream(int descriptor, const security::TlsContext* tls) : descriptor_(descriptor), context_(tls) {
  set_options(descriptor);
}

TcpStream::~TcpStream() {
  tls_.reset();
  close(descriptor_);
}

void TcpStream::wait(short events, Clock::time_point deadline) const {
  using namespace std::chrono;
  while (true) {
    int limit = -1;
    if (deadline != never) {
      const auto left = ceil<milliseconds>(deadline - Clock::now()).count();
      limit = static_cast<int>(std::clamp<milliseconds::rep>(left, 0, 3'600'000));
    }
    pollfd waiting{descriptor_, events, 0};
    if (poll(&waiting, 1, limit) > 0) return;  // also once, if this process stood still beyond the deadline
    if (limit == 0) throw TcpStreamError(Kind::timed_out, "nothing came in time");
  }
}

void TcpStream::begin_tls(const security::TlsContext& context) {
  ERR_clear_error();
  SSL* const ssl = SSL_new(context.get());
  if (ssl == nullptr) throw TcpStreamError(Kind::tls, security::tls_error());
  tls_ = std::make_unique<Tls>(ssl);
  BIO* const bio = BIO_new(bio_method());
  if (bio == nullptr) throw TcpStreamError(Kind::tls, security::tls_error());
  // A BIO keeps a pointer for its owner: here it holds the descriptor's number.
  BIO_set_data(bio,
               reinterpret_cast<void*>(static_cast<std::intptr_t>(descriptor_)));  // NOLINT(performance-no-int-to-ptr)
  BIO_set_init(bio, 1);
  SSL_set_bio(ssl, bio, bio);  // `ssl` owns the BIO from here on
}

void TcpStream::shake_hands(Clock::time_point deadline) {
  while (true) {
    ERR_clear_error();
    const int result = SSL_do_handshake(tls_->ssl);
    if (result == 1) break;
    after_tls(result, deadline);
  }
  tls_->usable = true;
}

void TcpStream::after_tls(int result, Clock::time_point deadline) {
  const int problem = errno;
  switch (SSL_get_error(tls_->ssl, result)) {
    case SSL_ERROR_WANT_READ:
      return wait(POLLIN, deadline);
    case SSL_ERROR_WANT_WRITE:
      return wait(POLLOUT, deadline);
    case SSL_ERROR_ZERO_RETURN:
      throw TcpStreamError(Kind::ended, "the connection was closed");
    case SSL_ERROR_SYSCALL:
      tls_->usable = false;
      if (problem == 0) throw TcpStreamError(Kind::ended, "the connection was closed");
      throw error_of(problem);
    default:
      break;
  }
  tls_->usable = false;
  const bool end = ERR_GET_REASON(ERR_peek_error()) == SSL_R_UNEXPECTED_EOF_WHILE_READING;
  const long verdict = SSL_get_verify_result(tls_->ssl);
  const std::string text = security::tls_error();
  if (end) throw TcpStreamError(Kind::ended, "the connection was closed");
  if (verdict == X509_V_OK) throw TcpStreamError(Kind::tls, "TLS: " + text);
  throw TcpStreamError(Kind::tls, fmt::format("TLS: {} ({})", text, X509_verify_cert_error_string(verdict)));
}

void TcpStream::accept(Clock::time_point deadline) {
  if (context_ == nullptr) return;
  begin_tls(*context_);
  SSL_set_accept_state(tls_->ssl);
  shake_hands(deadline);
}

std::unique_ptr<TcpStream> TcpStream::connect(const std::string& host, int port, const security::TlsContext* tls,
                                              Clock::time_point deadline) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int error = getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found); error != 0)
    throw TcpStreamError(Kind::broken, gai_strerror(error));
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> all(found, freeaddrinfo);
  int problem = EADDRNOTAVAIL;
  for (const addrinfo* one = found; one != nullptr; one = one->ai_next) {
    const int descriptor = socket(one->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (descriptor < 0) {
      problem = errno;
      continue;
    }
    auto stream = std::make_unique<TcpStream>(descriptor, tls);
    if (::connect(descriptor, one->ai_addr, one->ai_addrlen) != 0 && errno != EINPROGRESS) {
      problem = errno;
      continue;
    }
    stream->wait(POLLOUT, deadline);
    socklen_t size = sizeof problem;
    getsockopt(descriptor, SOL_SOCKET, SO_ERROR, &problem, &size);
    if (problem != 0) continue;
    if (tls == nullptr) return stream;
    stream->begin_tls(*tls);
    SSL* const ssl = stream->tls_->ssl;
    SSL_set_connect_state(ssl);
    security::expect_host(ssl, host);
    stream->shake_hands(deadline);
    return stream;
  }
  throw TcpStreamError(Kind::broken, std::strerror(problem));
}

std::size_t TcpStream::read_some(void* to, std::size_t size, Clock::time_point deadline) {
  if (tls_) {
    while (true) {
      std::size_t got = 0;
      ERR_clear_error();
      const int result = SSL_read_ex(tls_->ssl, to, size, &got);
      if (result == 1) return got;
      after_tls(result, deadline);
    }
  }
  while (true) {
    const auto got = recv(descriptor_, to, size, 0);
    if (got > 0) return static_cast<std::size_t>(got);
    if (got == 0) throw TcpStreamError(Kind::ended, "the connection was closed");
    if (errno != EAGAIN && errno != EINTR) throw error_of(errno);
    wait(POLLIN, deadline);
  }
}

void TcpStream::write_all(const void* from, std::size_t size, Clock::time_point deadline) {
  const auto* next = static_cast<const char*>(from);
  while (size > 0) {
    std::size_t sent = 0;
    if (tls_) {
      ERR_clear_error();
      const int result = SSL_write_ex(tls_->ssl, next, size, &sent);
      if (result != 1) {
        after_tls(result, deadline);
        continue;
      }
    } else {
      const auto result = send(descriptor_, next, size, MSG_NOSIGNAL);
      if (result < 0) {
        if (errno != EAGAIN && errno != EINTR) throw error_of(errno);
        wait(POLLOUT, deadline);
        continue;
      }
      sent = static_cast<std::size_t>(result);
    }
    next += sent;
    size -= sent;
  }
}

void TcpStream::cut() {
  shutdown(descriptor_, SHUT_RDWR);
}

void TcpStream::cut_reading() {
  shutdown(descriptor_, SHUT_RD);
}

security::ShownCertificate TcpStream::shown_certificate() const {
  return tls_ ? security::shown_certificate(tls_->ssl) : security::ShownCertificate{};
}

std::optional<uid_t> TcpStream::peer_user() const {
  return rpc::peer_user(descriptor_);
}

std::string TcpStream::peer_address() const {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> port{};
  if (getpeername(descriptor_, reinterpret_cast<sockaddr*>(&address), &size) != 0 ||
      getnameinfo(reinterpret_cast<sockaddr*>(&address), size, host.data(), host.size(), port.data(), port.size(),
                  NI_NUMERICHOST | NI_NUMERICSERV) != 0)
    return "unknown";
  return fmt::format("{}:{}", host.data(), port.data());
}

std::string TcpStream::peer_certificate() const {
  return tls_ ? security::peer_subject(tls_->ssl) : "";
}

bool TcpStream::is_peer(const security::NamedDaemon& daemon) const {
  return tls_ && security::is_peer(tls_->ssl, daemon);
}

}  // namespace iotcloud::rpc
