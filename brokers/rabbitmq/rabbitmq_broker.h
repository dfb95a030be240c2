#pragma once

#include <memory>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// Makes a broker that speaks AMQP 0-9-1 to RabbitMQ servers; `urls` are the parsed options.urls.
std::unique_ptr<Broker> make_rabbitmq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::rabbitmq
