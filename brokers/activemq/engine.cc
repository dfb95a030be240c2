#include "iotcloud/brokers/activemq/engine.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <memory>
#include <random>
#include <string_view>
#include <system_error>

#include <fmt/core.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <openssl/ssl.h>
#include <proton/condition.h>
#include <proton/connection.h>
#include <proton/delivery.h>
#include <proton/link.h>
#include <proton/sasl.h>
#include <proton/ssl.h>
#include <proton/transport.h>
#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/brokers/credentials.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::activemq {
namespace {

constexpr std::uint32_t largest_frame = 1U << 20U;
// A limit for one read, so that a fast server does not starve everything else.
constexpr std::size_t most_read_at_once = 1U << 20U;
constexpr const char* own_trouble = "iotcloud:socket";
constexpr const char* system_authorities = "/etc/ssl/certs/ca-certificates.crt";

std::int64_t to_ms(config::Clock::Instant time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
}

struct DomainFreer {
  void operator()(pn_ssl_domain_t* domain) const { pn_ssl_domain_free(domain); }
};

/// Proton's settings of TLS, and the OpenSSL context within them.
struct TlsDomain {
  std::unique_ptr<pn_ssl_domain_t, DomainFreer> domain;
  SSL_CTX* context = nullptr;  ///< the domain's; null: it has none
};

thread_local SSL_CTX* newest_context = nullptr;

/// Proton has no call for lists of revocations and does not show its context. But OpenSSL tells whoever asked for room
/// in contexts of each one that is made (SSL_CTX_get_ex_new_index), on the thread that makes it.
TlsDomain make_tls_domain() {
  static const int told = SSL_CTX_get_ex_new_index(
      0, nullptr,
      [](void* context, void*, CRYPTO_EX_DATA*, int, long, void*) { newest_context = static_cast<SSL_CTX*>(context); },
      nullptr, nullptr);
  newest_context = nullptr;
  TlsDomain made{std::unique_ptr<pn_ssl_domain_t, DomainFreer>(pn_ssl_domain(PN_SSL_MODE_CLIENT))};
  made.context = told < 0 ? nullptr : newest_context;
  return made;
}

std::string unique_name(const std::string& purpose) {
  std::random_device random;
  return fmt::format("iotcloud-{}-{:08x}{:08x}", purpose, random(), random());
}

}  // namespace

bool is_tls(const BrokerUrl& url) {
  return url.scheme.ends_with('s');
}

std::uint16_t port_of(const BrokerUrl& url) {
  return server_port(url);
}

std::string describe(pn_condition_t* condition) {
  if (condition == nullptr || !pn_condition_is_set(condition)) return "the server closed it";
  const char* const description = pn_condition_get_description(condition);
  std::string text = pn_condition_get_name(condition);
  if (text == own_trouble) return description;
  if (description != nullptr && *description != '\0') text += std::string(": ") + description;
  return text;
}

bool is_final(pn_condition_t* condition) {
  if (condition == nullptr || !pn_condition_is_set(condition)) return false;
  // ActiveMQ closes the connection with the first one for a message that it cannot read or that is too large, and
  // rejects a message with "failed" whatever went wrong with it: its store, a permission, another server. The others
  // are those of AMQP 1.0 (2.8.15 to 2.8.18) for what is malformed or too large.
  constexpr std::array never{"amqp:decode-error", "amqp:invalid-field", "amqp:frame-size-too-small",
                             "amqp:connection:framing-error", "amqp:link:message-size-exceeded"};
  const std::string_view name = pn_condition_get_name(condition);
  return std::find(never.begin(), never.end(), name) != never.end();
}

void Engine::AddressesFreer::operator()(addrinfo* list) const {
  ::freeaddrinfo(list);
}

Engine::Engine(const BrokerOptions& options, const BrokerUrl& url, const std::string& purpose,
               const config::Clock& clock, ServerTrust& trust)
    : clock_(clock) {
  const Credentials credentials = credentials_for(options, url);
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int error = ::getaddrinfo(url.host.c_str(), std::to_string(port_of(url)).c_str(), &hints, &found);
      error != 0) {
    throw config::Error("the host " + url.host + " is not known: " + ::gai_strerror(error));
  }
  addresses_.reset(found);
  next_address_ = found;
  if (pn_connection_driver_init(&driver_, nullptr, nullptr) != 0) throw std::bad_alloc();
  destroyer_.reset(&driver_);
  // The server knows connections by this name, and accepts each name once.
  pn_connection_set_container(connection(), unique_name(purpose).c_str());
  pn_connection_set_hostname(connection(), url.host.c_str());
  pn_transport_set_idle_timeout(transport(), static_cast<pn_millis_t>(2 * options.heartbeat.count()));
  pn_transport_set_max_frame(transport(), largest_frame);
  pn_sasl_t* const sasl = pn_sasl(transport());
  pn_sasl_set_allow_insecure_mechs(sasl, true);  // PLAIN without TLS, as the URL asks
  if (credentials.user.empty()) {
    pn_sasl_allowed_mechs(sasl, "ANONYMOUS");
  } else {
    pn_sasl_allowed_mechs(sasl, "PLAIN");
    pn_connection_set_user(connection(), credentials.user.c_str());
    pn_connection_set_password(connection(), credentials.password.c_str());
  }
  if (is_tls(url)) protect(options, url, trust);
  pn_connection_driver_bind(&driver_);
  connect_next();
}

Engine::~Engine() {
  if (socket_ >= 0) ::close(socket_);
}

void Engine::protect(const BrokerOptions& options, const BrokerUrl& url, ServerTrust& trust) {
  const TlsDomain made = make_tls_domain();
  const auto& domain = made.domain;
  if (!domain) throw config::Error("this qpid-proton has no TLS");
  const Tls& tls = options.tls;
  const std::string authorities = tls.ca_file.empty() ? system_authorities : tls.ca_file;
  if (!tls.certificate_file.empty() &&
      pn_ssl_domain_set_credentials(domain.get(), tls.certificate_file.c_str(), tls.key_file.c_str(), nullptr) != 0) {
    throw config::Error("cannot use the certificate " + tls.certificate_file + " with the key " + tls.key_file);
  }
  if (pn_ssl_domain_set_trusted_ca_db(domain.get(), authorities.c_str()) != 0 ||
      pn_ssl_domain_set_peer_authentication(domain.get(), PN_SSL_VERIFY_PEER_NAME, nullptr) != 0) {
    throw config::Error("cannot read the certificates of the authorities in " + authorities);
  }
  if (made.context != nullptr) {
    shown_ = trust.guard(made.context);
  } else if (!tls.revoked_file.empty()) {
    throw config::Error(
        "this qpid-proton does not use OpenSSL, so tls.revoked cannot be obeyed: take the key out, and replace "
        "tls.ca when a server's certificate is revoked");
  }
  pn_ssl_t* const ssl = pn_ssl(transport());
  if (pn_ssl_init(ssl, domain.get(), nullptr) != 0) throw config::Error("cannot begin TLS");
  pn_ssl_set_peer_hostname(ssl, url.host.c_str());
}

void Engine::connect_next() {
  int error = ENOENT;
  while (next_address_ != nullptr) {
    const addrinfo* const address = next_address_;
    next_address_ = address->ai_next;
    if (socket_ >= 0) ::close(socket_);
    socket_ = ::socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (socket_ < 0) {
      error = errno;
      continue;
    }
    const int yes = 1;
    ::setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof(yes));
    if (::connect(socket_, address->ai_addr, address->ai_addrlen) == 0 || errno == EINPROGRESS) return;
    error = errno;
  }
  fail(error);
}

void Engine::finish_connecting() {
  int error = 0;
  socklen_t length = sizeof(error);
  if (::getsockopt(socket_, SOL_SOCKET, SO_ERROR, &error, &length) != 0) error = errno;
  if (error == 0) {
    connecting_ = false;
  } else if (next_address_ != nullptr) {
    connect_next();
  } else {
    fail(error);
  }
}

void Engine::fail(int error) {
  connecting_ = false;
  unwritten_ = false;
  pn_connection_driver_errorf(&driver_, own_trouble, "%s", std::generic_category().message(error).c_str());
  pn_connection_driver_close(&driver_);
}

void Engine::receive(bool readable, bool writable) {
  if (connecting_) {
    if (!readable && !writable) return;
    finish_connecting();
    if (connecting_) return;
  }
  // Take the time before the socket is read: bytes that arrived while this process stood still then count as a sign of
  // life of the server.
  const auto looked_at = clock_.now();
  const bool came = read();
  pn_transport_tick(transport(), to_ms(came ? clock_.now() : looked_at));
}

bool Engine::read() {
  std::size_t taken = 0;
  while (taken < most_read_at_once) {
    const pn_rwbytes_t room = pn_connection_driver_read_buffer(&driver_);
    if (room.size == 0) break;
    const ssize_t count = ::recv(socket_, room.start, room.size, 0);
    if (count > 0) {
      pn_connection_driver_read_done(&driver_, static_cast<std::size_t>(count));
      taken += static_cast<std::size_t>(count);
      if (static_cast<std::size_t>(count) < room.size) break;  // the socket is empty
    } else if (count == 0) {
      pn_connection_driver_read_close(&driver_);
      break;
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      break;
    } else if (errno != EINTR) {
      fail(errno);
      break;
    }
  }
  return taken > 0;
}

void Engine::send() {
  if (connecting_) return;
  unwritten_ = false;
  for (;;) {
    const pn_bytes_t bytes = pn_connection_driver_write_buffer(&driver_);
    if (bytes.size == 0) return;
    const ssize_t count = ::send(socket_, bytes.start, bytes.size, MSG_NOSIGNAL);
    if (count > 0) {
      pn_connection_driver_write_done(&driver_, static_cast<std::size_t>(count));
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      unwritten_ = true;
      return;
    } else if (errno != EINTR) {
      fail(errno);
      return;
    }
  }
}

pn_delivery_t* send_message(pn_link_t* sender, std::uint64_t tag, std::string_view head, std::string_view body) {
  char bytes[sizeof(tag)];
  std::memcpy(bytes, &tag, sizeof(tag));
  pn_delivery_t* const delivery = pn_delivery(sender, pn_dtag(bytes, sizeof(bytes)));
  pn_link_send(sender, head.data(), head.size());
  if (!body.empty()) pn_link_send(sender, body.data(), body.size());
  pn_link_advance(sender);
  return delivery;
}

WireBytes receive_message(pn_delivery_t* delivery) {
  pn_link_t* const receiver = pn_delivery_link(delivery);
  const std::size_t size = pn_delivery_pending(delivery);
  auto bytes = std::make_shared_for_overwrite<char[]>(std::max<std::size_t>(size, 1));
  const ssize_t taken = size == 0 ? 0 : pn_link_recv(receiver, bytes.get(), size);
  pn_link_advance(receiver);
  const char* const start = bytes.get();
  return {std::move(bytes), {start, static_cast<std::size_t>(std::max<ssize_t>(taken, 0))}};
}

}  // namespace iotcloud::brokers::activemq
