#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// The user with which a connection logs in: the broker's user, or for reading the broker's `reader`, if it has one.
enum class Login { writer, reader };

/// The servers of one broker, how to connect to them, and how their queues are declared. Thread safe.
class Cluster {
 public:
  /// \throws config::Error for a property that RabbitMQ does not have, and for a bad value.
  Cluster(const BrokerOptions& options, std::vector<BrokerUrl> urls);

  std::size_t size() const { return urls_.size(); }
  /// For logs: the URL without its password.
  const std::string& name(std::size_t server) const { return names_.at(server); }
  const BrokerUrl& url(std::size_t server) const { return urls_.at(server); }
  /// Connects and logs in, with the password as it is now. \param purpose shown by RabbitMQ's tools. \throws LinkError
  std::unique_ptr<AmqpLink> connect(std::size_t server, const char* purpose, Login login) const;

  /// Whom the connections trust.
  ServerTrust& trust() const { return *trust_; }

  std::chrono::milliseconds rpc_timeout() const { return options_.rpc_timeout; }
  QueueType queue_type() const { return queue_type_; }
  /// How long a message may wait for an answer before the connection is made anew.
  std::chrono::milliseconds confirm_timeout() const { return confirm_timeout_; }
  /// How many channels a connection asks for.
  int channels() const { return channels_; }

 private:
  static BrokerOptions reader_options(BrokerOptions options);

  const BrokerOptions options_;
  const BrokerOptions of_readers_;  ///< with the user for reading; without one as options_
  const std::vector<BrokerUrl> urls_;
  std::vector<std::string> names_;
  const std::unique_ptr<ServerTrust> trust_;  ///< thread safe by itself
  QueueType queue_type_ = QueueType::classic;
  int channels_ = 2047;
  std::chrono::milliseconds confirm_timeout_{10'000};
};

}  // namespace iotcloud::brokers::rabbitmq
