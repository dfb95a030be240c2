#pragma once

#include <memory>
#include <string>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::embedded {

/// A broker of the in-process server `name` (see server.h).
std::unique_ptr<Broker> make_embedded_broker(const BrokerOptions& options, const std::string& name);

}  // namespace iotcloud::brokers::embedded
