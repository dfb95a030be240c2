#pragma once

#include <memory>
#include <vector>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::kafka {

/// A broker that speaks to Kafka; `urls` are options.urls, parsed: the servers to ask first.
/// \throws config::Error for properties that make no sense.
std::unique_ptr<Broker> make_kafka_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::kafka
