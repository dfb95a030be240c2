#include <array>
#include <cerrno>
#include <cstring>

#include <arpa/inet.h>
#include <fcntl.h>
#include <hiredis/hiredis.h>
#include <netdb.h>
#include <netinet/tcp.h>
#include <openssl/err.h>
#include <openssl/x509v3.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/state/redis/redis_connection.h>

namespace iotcloud::topology::internal {

namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

std::string tls_error() {
  const unsigned long code = ERR_get_error();
  ERR_clear_error();
  return code == 0                                  ? "no reason given"
         : ERR_reason_error_string(code) == nullptr ? "unknown error"
                                                    : ERR_reason_error_string(code);
}

RedisReply reply_of(const redisReply& given) {
  RedisReply reply;
  switch (given.type) {
    case REDIS_REPLY_NIL:
      reply.is_nothing = true;
      break;
    case REDIS_REPLY_INTEGER:
      reply.text = std::to_string(given.integer);
      break;
    case REDIS_REPLY_ARRAY:
      for (std::size_t i = 0; i < given.elements; ++i) reply.list.push_back(reply_of(*given.element[i]));
      break;
    default:
      reply.text.assign(given.str, given.len);
  }
  return reply;
}

}  // namespace

RedisConnection::RedisConnection(const RedisAddress& address, const RedisServer& server, milliseconds limit,
                                 brokers::ServerTrust& trust)
    : limit_(limit),
      server_(server),
      name_(server.host + ":" + std::to_string(server.port)),
      trust_(trust),
      reader_(redisReaderCreate()) {
  end_ = steady_clock::now() + limit_;
  try {
    connect(server);
    if (address.tls) begin_tls(address, server);
  } catch (...) {
    if (socket_ >= 0) ::close(socket_);
    throw;
  }
}

RedisConnection::~RedisConnection() {
  ::close(socket_);
}

void RedisConnection::connect(const RedisServer& server) {
  addrinfo wanted{};
  wanted.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int error = getaddrinfo(server.host.c_str(), std::to_string(server.port).c_str(), &wanted, &found)) {
    fail(gai_strerror(error));
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, &freeaddrinfo);
  int error = 0;
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    socket_ = ::socket(each->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (socket_ < 0) fail(std::strerror(errno));
    error = ::connect(socket_, each->ai_addr, each->ai_addrlen) == 0 ? 0 : errno;
    if (error == EINPROGRESS) {
      wait(POLLOUT);
      socklen_t size = sizeof error;
      ::getsockopt(socket_, SOL_SOCKET, SO_ERROR, &error, &size);
    }
    if (error == 0) break;
    ::close(std::exchange(socket_, -1));
  }
  if (error != 0) fail(std::strerror(error));
  const int on = 1;
  ::setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
}

void RedisConnection::begin_tls(const RedisAddress& address, const RedisServer& server) {
  context_.reset(SSL_CTX_new(TLS_client_method()));
  SSL_CTX_set_min_proto_version(context_.get(), TLS1_2_VERSION);
  SSL_CTX_set_verify(context_.get(), SSL_VERIFY_PEER, nullptr);
  const bool trusts = address.ca_file.empty()
                          ? SSL_CTX_set_default_verify_paths(context_.get()) == 1
                          : SSL_CTX_load_verify_locations(context_.get(), address.ca_file.c_str(), nullptr) == 1;
  if (!trusts) throw StateError("the authorities in \"" + address.ca_file + "\" cannot be read: " + tls_error());
  if (!address.certificate_file.empty() &&
      (SSL_CTX_use_certificate_chain_file(context_.get(), address.certificate_file.c_str()) != 1 ||
       SSL_CTX_use_PrivateKey_file(context_.get(), address.key_file.c_str(), SSL_FILETYPE_PEM) != 1)) {
    throw StateError("the certificate \"" + address.certificate_file + "\" or its key \"" + address.key_file +
                     "\" cannot be used: " + tls_error());
  }
  try {
    shown_ = trust_.guard(context_.get());
  } catch (const config::Error& error) {
    throw StateError(error.what());
  }
  tls_.reset(SSL_new(context_.get()));
  SSL_set_bio(tls_.get(), BIO_new(BIO_s_mem()), BIO_new(BIO_s_mem()));
  std::array<unsigned char, sizeof(in6_addr)> ignored{};
  const bool is_number = inet_pton(AF_INET, server.host.c_str(), ignored.data()) == 1 ||
                         inet_pton(AF_INET6, server.host.c_str(), ignored.data()) == 1;
  if (is_number) {
    X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls_.get()), server.host.c_str());
  } else {
    SSL_set1_host(tls_.get(), server.host.c_str());
    // SSL_set_tlsext_host_name() is a macro with an old-style cast. The library copies the name.
    SSL_ctrl(tls_.get(), SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name,
             const_cast<char*>(server.host.c_str()));
  }
  SSL_set_connect_state(tls_.get());
  for (;;) {
    ERR_clear_error();
    const int done = SSL_do_handshake(tls_.get());
    send_encrypted();
    if (done == 1) return;
    if (SSL_get_error(tls_.get(), done) != SSL_ERROR_WANT_READ) {
      const long verdict = SSL_get_verify_result(tls_.get());
      if (verdict == X509_V_OK) fail("TLS: " + tls_error());
      throw StateError("the Redis at " + name_ + " is not believed to be the right one: " +
                       X509_verify_cert_error_string(verdict) + "; ca_file names whom to trust, revoked_file whom not");
    }
    receive_encrypted();
  }
}

void RedisConnection::check_server(brokers::ServerTrust::Instant now) {
  if (!shown_) return;
  const std::string why = trust_.distrust(*shown_, now);
  if (!why.empty()) throw StateUnavailable("the Redis at " + name_ + " is left: " + why);
}

RedisReply RedisConnection::ask(const std::vector<std::string>& words) {
  end_ = steady_clock::now() + limit_;
  std::vector<const char*> starts;
  std::vector<std::size_t> sizes;
  for (const std::string& word : words) {
    starts.push_back(word.data());
    sizes.push_back(word.size());
  }
  char* command = nullptr;
  const auto size = redisFormatCommandArgv(&command, static_cast<int>(words.size()), starts.data(), sizes.data());
  const std::unique_ptr<char, decltype(&redisFreeCommand)> owned(command, &redisFreeCommand);
  if (size < 0) fail("the command cannot be encoded");
  send({command, static_cast<std::size_t>(size)});
  for (;;) {
    void* got = nullptr;
    if (redisReaderGetReply(reader_.get(), &got) != REDIS_OK) fail(reader_->errstr);
    if (got != nullptr) {
      const std::unique_ptr<void, decltype(&freeReplyObject)> answer(got, &freeReplyObject);
      const auto& reply = *static_cast<const redisReply*>(got);
      if (reply.type == REDIS_REPLY_ERROR) throw RedisRefusal(std::string(reply.str, reply.len));
      return reply_of(reply);
    }
    std::array<char, 16384> chunk;
    const std::size_t received = receive(chunk.data(), chunk.size());
    redisReaderFeed(reader_.get(), chunk.data(), received);
  }
}

void RedisConnection::send(std::string_view bytes) {
  if (!tls_) return send_plain(bytes);
  ERR_clear_error();
  // SSL_write() writes to memory here, so one call takes all bytes.
  if (!bytes.empty() && SSL_write(tls_.get(), bytes.data(), static_cast<int>(bytes.size())) <= 0) {
    fail("TLS: " + tls_error());
  }
  send_encrypted();
}

std::size_t RedisConnection::receive(char* place, std::size_t size) {
  if (!tls_) return receive_plain(place, size);
  for (;;) {
    ERR_clear_error();
    const int got = SSL_read(tls_.get(), place, static_cast<int>(size));
    if (got > 0) return static_cast<std::size_t>(got);
    if (SSL_get_error(tls_.get(), got) != SSL_ERROR_WANT_READ) fail("TLS: " + tls_error());
    send_encrypted();  // SSL_read() may have answered a key update of the server
    receive_encrypted();
  }
}

void RedisConnection::send_encrypted() {
  BIO* const out = SSL_get_wbio(tls_.get());
  std::array<char, 16384> chunk;
  for (int size; (size = BIO_read(out, chunk.data(), static_cast<int>(chunk.size()))) > 0;) {
    send_plain({chunk.data(), static_cast<std::size_t>(size)});
  }
}

void RedisConnection::receive_encrypted() {
  std::array<char, 16384> chunk;
  const std::size_t size = receive_plain(chunk.data(), chunk.size());
  BIO_write(SSL_get_rbio(tls_.get()), chunk.data(), static_cast<int>(size));
}

void RedisConnection::send_plain(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t sent = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (sent >= 0) {
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    } else if (errno == EAGAIN) {
      wait(POLLOUT);
    } else if (errno != EINTR) {
      fail(std::strerror(errno));
    }
  }
}

std::size_t RedisConnection::receive_plain(char* place, std::size_t size) {
  for (;;) {
    const ssize_t got = ::recv(socket_, place, size, 0);
    if (got > 0) return static_cast<std::size_t>(got);
    if (got == 0) fail("it closed the connection");
    if (errno == EAGAIN) {
      wait(POLLIN);
    } else if (errno != EINTR) {
      fail(std::strerror(errno));
    }
  }
}

void RedisConnection::wait(short events) {
  for (;;) {
    const auto left = std::chrono::ceil<milliseconds>(end_ - steady_clock::now());
    pollfd waiting{socket_, events, 0};
    const int ready = left.count() > 0 ? ::poll(&waiting, 1, static_cast<int>(left.count())) : 0;
    if (ready > 0) return;
    if (ready == 0) fail("no answer within " + std::to_string(limit_.count()) + " ms");
    if (errno != EINTR) fail(std::strerror(errno));
  }
}

void RedisConnection::fail(const std::string& what) const {
  throw StateUnavailable("the Redis at " + name_ + " cannot be reached: " + what);
}

}  // namespace iotcloud::topology::internal
