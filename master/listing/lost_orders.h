#pragma once

#include <vector>

#include <iotcloud/discovery/directory.h>

namespace iotcloud::master {

/// The orders to lost gateways that no gateway has reported on: a record for each instance, in the state `ordered`,
/// whose reason says that its gateway is lost. Without them nobody would see, or could name, an order that waits for a
/// gateway. \param drivers the records that there are. \throws discovery::RegistryError.
std::vector<discovery::DriverRecord> lost_orders(discovery::Registry& registry, const discovery::Paths& paths,
                                                 const std::vector<discovery::DriverRecord>& drivers);

}  // namespace iotcloud::master
