#pragma once

#include <memory>
#include <vector>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::activemq {

/// Makes a broker that speaks AMQP 1.0 to ActiveMQ (Classic) servers; `urls` are the parsed options.urls.
std::unique_ptr<Broker> make_activemq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::activemq
