#include "iotcloud/brokers/rabbitmq/wire/socket.h"

#include <amqp_ssl_socket.h>
#include <amqp_tcp_socket.h>
#include <fmt/core.h>
#include <openssl/ssl.h>

#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

/// Reports a wrong setting: the connection must not be tried.
[[noreturn]] void unusable(const std::string& what, const std::string& file, const char* remedy) {
  throw LinkError(fmt::format("the {} \"{}\" cannot be used: {}", what, file, remedy));
}

}  // namespace

bool wants_tls(const BrokerUrl& url) {
  return url.scheme == "amqps";
}

int port_of(const BrokerUrl& url) {
  return server_port(url);
}

const char* explain(int status) {
  switch (status) {
    case AMQP_STATUS_SOCKET_ERROR:
    case AMQP_STATUS_TCP_ERROR:
      return "the connection broke";
    case AMQP_STATUS_CONNECTION_CLOSED:
    case AMQP_STATUS_SOCKET_CLOSED:
      return "the server closed the connection";
    case AMQP_STATUS_HEARTBEAT_TIMEOUT:
      return "no sign of life from the server";
    case AMQP_STATUS_TIMEOUT:
      return "no answer in time";
    case AMQP_STATUS_SSL_PEER_VERIFY_FAILED:
      return "the server's certificate is of no authority that is trusted here (see tls.ca), or it has expired, or is "
             "revoked, or its authority has no list that holds now in tls.revoked";
    case AMQP_STATUS_SSL_HOSTNAME_VERIFY_FAILED:
      return "the server's certificate is for another host name than the URL's";
    case AMQP_STATUS_SSL_CONNECTION_FAILED:
      return "the TLS handshake failed: the server's certificate is not trusted (see tls.ca), or it does not take this "
             "client's, or it speaks no TLS 1.2";
    case AMQP_STATUS_SSL_ERROR:
      return "TLS failed: perhaps the server does not take this client's certificate (see tls.certificate)";
    default:
      return amqp_error_string2(status);
  }
}

amqp_socket_t* make_socket(amqp_connection_state_t state, const BrokerUrl& url, const Tls& tls) {
  amqp_socket_t* socket = wants_tls(url) ? amqp_ssl_socket_new(state) : amqp_tcp_socket_new(state);
  if (socket == nullptr) throw LinkError("out of memory");
  if (!wants_tls(url)) return socket;
  amqp_ssl_socket_set_verify_peer(socket, 1);
  amqp_ssl_socket_set_verify_hostname(socket, 1);
  if (amqp_ssl_socket_set_ssl_versions(socket, AMQP_TLSv1_2, AMQP_TLSvLATEST) != AMQP_STATUS_OK) {
    throw LinkError("this librabbitmq speaks no TLS 1.2");
  }
  if (tls.ca_file.empty()) {
    SSL_CTX_set_default_verify_paths(static_cast<SSL_CTX*>(amqp_ssl_socket_get_context(socket)));
  } else if (amqp_ssl_socket_set_cacert(socket, tls.ca_file.c_str()) != AMQP_STATUS_OK) {
    unusable("file of trusted authorities", tls.ca_file, "it must hold their certificates in PEM form");
  }
  if (!tls.certificate_file.empty() &&
      amqp_ssl_socket_set_key(socket, tls.certificate_file.c_str(), tls.key_file.c_str()) != AMQP_STATUS_OK) {
    unusable(
        "client certificate", tls.certificate_file,
        fmt::format("it and its key \"{}\" must be readable, in PEM form, and belong together", tls.key_file).c_str());
  }
  return socket;
}

std::shared_ptr<ShownChain> guard(amqp_socket_t* socket, ServerTrust& trust) {
  try {
    return trust.guard(static_cast<SSL_CTX*>(amqp_ssl_socket_get_context(socket)));
  } catch (const config::Error& error) {
    throw LinkError(error.what());
  }
}

void open_socket(amqp_socket_t* socket, const BrokerUrl& url, std::chrono::milliseconds limit) {
  const timeval wait{limit.count() / 1000, limit.count() % 1000 * 1000};
  const int status = amqp_socket_open_noblock(socket, url.host.c_str(), port_of(url), &wait);
  if (status == AMQP_STATUS_OK) return;
  throw LinkError(status == AMQP_STATUS_SOCKET_ERROR
                      ? fmt::format("nobody listens at {} port {}, or it cannot be reached", url.host, port_of(url))
                      : explain(status));
}

}  // namespace iotcloud::brokers::rabbitmq
