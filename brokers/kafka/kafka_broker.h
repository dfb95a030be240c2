#pragma once

#include <memory>
#include <vector>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::kafka {

/// Makes a broker that speaks to Kafka; `urls` are the parsed options.urls: the servers to ask first.
/// \throws config::Error for wrong properties.
std::unique_ptr<Broker> make_kafka_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::kafka
