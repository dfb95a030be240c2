#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/api/gateway_asks.h>
#include <iotcloud/master/gateways/gateway_access.h>
#include <iotcloud/master/orders/answers.h>

namespace iotcloud::master {

class Master;

/// The changes of state that gateways remember of their instances, also from before a restart of the gateway. All
/// gateways are asked at the same time.
/// \param instances ids, or beginnings of ids; empty: all. \param gateways empty: all that are registered.
/// \param most limits the answer to the latest changes; 0 or more than 10 000 means 10 000.
/// \throws config::Error when the registry is away or a gateway is not registered.
DriverHistory read_history(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                           const std::vector<std::string>& instances, const std::vector<discovery::GatewayId>& gateways,
                           std::int32_t most);

/// The plugins that gateways have. All gateways are asked at the same time. \param gateways as in read_history().
/// \throws config::Error when the registry is away or a gateway is not registered.
GatewayPlugins read_plugins(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                            const std::vector<discovery::GatewayId>& gateways);

/// What the driver hosts of the gateways that answer have carried, in no order. Gateways of the original, and those
/// that are lost, are not asked; the others are asked at the same time. \throws config::Error when the registry is away
std::vector<CarriedByGateway> read_carried(const Master& master, const GatewayAccess& access, GatewayAsks& asks);

/// A part of the log of an instance's driver host. \param position from an earlier part, which this one continues;
/// empty: the end of the log.
/// \throws config::Error when the log cannot be read, with the reason.
LogPart read_log(const Master& master, const GatewayAccess& access, const discovery::GatewayId& gateway,
                 const discovery::InstanceId& instance, const std::string& position, std::int32_t most_bytes);

/// Looks at a channel of an instance, and hands an instance a message: the instance's driver host does both, and its
/// gateway passes them on. The answer's `problem` says why nothing was done.
/// \throws config::Error when the gateway cannot be asked, with the reason.
discovery::ChannelLook look_at_channel(const Master& master, const GatewayAccess& access,
                                       const discovery::GatewayId& gateway, const discovery::LookRequest& request);
discovery::ChannelLook hand_message(const Master& master, const GatewayAccess& access,
                                    const discovery::GatewayId& gateway, const discovery::HandedMessage& message);

}  // namespace iotcloud::master
