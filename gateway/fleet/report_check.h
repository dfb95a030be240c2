#pragma once

#include <string>
#include <vector>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// Finds what in a host's report about an instance contradicts what this gateway knows: names that are not the
/// instance's, a broker or an address that its configuration does not list. A host runs foreign code, and readers of
/// the records follow them. \param driver the name that the instance's driver has; empty: not known.
/// \return for people; empty: nothing.
std::string contradiction(const InstanceStatus& told, const discovery::OrderRecord& order,
                          const discovery::DriverName& driver, const discovery::GatewayId& gateway,
                          const std::vector<brokers::BrokerSetting>& brokers);

}  // namespace iotcloud::gateway
