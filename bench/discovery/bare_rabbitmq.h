#pragma once

#include <string>

#include <amqp.h>

namespace iotcloud::bench {

/// A client on librabbitmq alone, which makes one request after the other on one connection. Every failure throws
/// std::runtime_error.
class BareRabbitMq {
 public:
  explicit BareRabbitMq(const std::string& url);
  ~BareRabbitMq();
  BareRabbitMq(const BareRabbitMq&) = delete;
  BareRabbitMq& operator=(const BareRabbitMq&) = delete;

  void declare(const std::string& queue);
  void consume(const std::string& queue);
  /// How many consumers the queue has; -1 if it does not exist.
  int readers(const std::string& queue);

 private:
  void open_channel();
  void check(const std::string& what);
  amqp_connection_state_t connection_;
  amqp_channel_t channel_ = 0;
};

}  // namespace iotcloud::bench
