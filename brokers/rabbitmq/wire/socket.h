#pragma once

#include <chrono>
#include <string>

#include <amqp.h>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// The socket of a connection to this URL, not yet open, owned by `state`: plain, or for "amqps" TLS 1.2 or later that
/// checks the server's certificate and its name. \throws LinkError naming the file that cannot be used.
amqp_socket_t* make_socket(amqp_connection_state_t state, const BrokerUrl& url, const Tls& tls);

/// Opens it. \throws LinkError that says what is wrong: nobody listens, no answer, a certificate that is not trusted.
void open_socket(amqp_socket_t* socket, const BrokerUrl& url, std::chrono::milliseconds limit);

bool wants_tls(const BrokerUrl& url);

/// The URL's, or the protocol's own.
int port_of(const BrokerUrl& url);

/// Words for the library's status.
const char* explain(int status);

}  // namespace iotcloud::brokers::rabbitmq
