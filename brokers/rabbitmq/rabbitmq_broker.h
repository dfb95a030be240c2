#pragma once

#include <memory>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// A broker that speaks AMQP 0-9-1 to a RabbitMQ server; `urls` are options.urls, parsed.
std::unique_ptr<Broker> make_rabbitmq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::rabbitmq
