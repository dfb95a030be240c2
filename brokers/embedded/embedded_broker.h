#pragma once

#include <memory>
#include <vector>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::embedded {

/// Makes a broker on the in-process server that the first URL names (see server.h).
std::unique_ptr<Broker> make_embedded_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

}  // namespace iotcloud::brokers::embedded
