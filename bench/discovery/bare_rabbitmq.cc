#include <stdexcept>

#include <amqp_tcp_socket.h>

#include <iotcloud/bench/discovery/bare_rabbitmq.h>

namespace iotcloud::bench {

namespace {

amqp_bytes_t bytes_of(const std::string& text) {
  return {text.size(), const_cast<char*>(text.data())};
}

}  // namespace

BareRabbitMq::BareRabbitMq(const std::string& url) : connection_(amqp_new_connection()) {
  amqp_connection_info server;
  amqp_default_connection_info(&server);
  std::string text = url;
  if (amqp_parse_url(text.data(), &server) != AMQP_STATUS_OK) throw std::runtime_error("cannot read " + url);
  amqp_socket_t* socket = amqp_tcp_socket_new(connection_);
  if (amqp_socket_open(socket, server.host, server.port) != AMQP_STATUS_OK) {
    throw std::runtime_error("cannot connect to " + url);
  }
  const char* virtual_host = *server.vhost != 0 ? server.vhost : "/";
  const auto reply =
      amqp_login(connection_, virtual_host, 0, 131072, 0, AMQP_SASL_METHOD_PLAIN, server.user, server.password);
  if (reply.reply_type != AMQP_RESPONSE_NORMAL) throw std::runtime_error("cannot log in at " + url);
  open_channel();
}

BareRabbitMq::~BareRabbitMq() {
  amqp_connection_close(connection_, AMQP_REPLY_SUCCESS);
  amqp_destroy_connection(connection_);
}

void BareRabbitMq::open_channel() {
  amqp_channel_open(connection_, ++channel_);
  check("open a channel");
}

void BareRabbitMq::check(const std::string& what) {
  if (amqp_get_rpc_reply(connection_).reply_type != AMQP_RESPONSE_NORMAL) {
    throw std::runtime_error("RabbitMQ refused to " + what);
  }
}

void BareRabbitMq::declare(const std::string& queue) {
  amqp_queue_declare(connection_, channel_, bytes_of(queue), 0, 0, 0, 0, amqp_empty_table);
  check("declare " + queue);
}

void BareRabbitMq::consume(const std::string& queue) {
  amqp_basic_consume(connection_, channel_, bytes_of(queue), amqp_empty_bytes, 0, 0, 1, amqp_empty_table);
  check("consume " + queue);
}

int BareRabbitMq::readers(const std::string& queue) {
  const auto* known = amqp_queue_declare(connection_, channel_, bytes_of(queue), 1, 0, 0, 0, amqp_empty_table);
  if (known != nullptr) return static_cast<int>(known->consumer_count);
  const auto reply = amqp_get_rpc_reply(connection_);  // a missing queue closes the channel
  if (reply.reply_type != AMQP_RESPONSE_SERVER_EXCEPTION || reply.reply.id != AMQP_CHANNEL_CLOSE_METHOD) {
    throw std::runtime_error("RabbitMQ does not tell of " + queue);
  }
  amqp_channel_close_ok_t closed;
  amqp_send_method(connection_, channel_, AMQP_CHANNEL_CLOSE_OK_METHOD, &closed);
  amqp_maybe_release_buffers(connection_);
  open_channel();
  return -1;
}

}  // namespace iotcloud::bench
