#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <amqp.h>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// Makes the socket for a connection to this URL, not yet open, owned by `state`: plain, or for "amqps" TLS 1.2 or
/// later, which checks the server's certificate and its name. \throws LinkError naming the unusable file.
amqp_socket_t* make_socket(amqp_connection_state_t state, const BrokerUrl& url, const Tls& tls);

/// Has the socket, one for "amqps" that is not open yet, trust only whom `trust` trusts. \return it outlives the
/// socket. \throws LinkError naming the unusable file.
std::shared_ptr<ShownChain> guard(amqp_socket_t* socket, ServerTrust& trust);

/// Opens the socket. \throws LinkError with the reason: nobody listens, no answer, an untrusted certificate.
void open_socket(amqp_socket_t* socket, const BrokerUrl& url, std::chrono::milliseconds limit);

bool wants_tls(const BrokerUrl& url);

/// The URL's port, or the protocol's default.
int port_of(const BrokerUrl& url);

/// A text for the library's status.
const char* explain(int status);

}  // namespace iotcloud::brokers::rabbitmq
