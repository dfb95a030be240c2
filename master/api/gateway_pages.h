#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/originals/site_client.h>

namespace iotcloud::master {

class Master;

/// How this master shows the gateways' Thrift services who it is.
struct GatewayAccess {
  config::TlsFiles tls;    ///< for those that speak TLS
  std::string token_file;  ///< its first line is the token that those with TLS are shown; empty: none
};

/// Where the gateway's Thrift service answers. \throws config::Error when it cannot be asked, with the reason.
SiteAddress address_of(const discovery::GatewayStatus& gateway, const GatewayAccess& access);

struct DriverHistory {
  std::vector<DriverChange> changes;          ///< the oldest first
  std::map<std::string, std::string> silent;  ///< gateways that could not be asked, and why
};

/// What gateways remember of their instances' states since they started; all are asked at the same time.
/// \param instances ids, or how they begin; empty: of all. \param gateways empty: all that are registered.
/// \param most so many of the latest at most; 0, and more than 10 000: 10 000.
/// \throws config::Error when the registry is away or a gateway is not registered.
DriverHistory read_history(const Master& master, const GatewayAccess& access, const std::vector<std::string>& instances,
                           const std::vector<std::string>& gateways, std::int32_t most);

/// What the driver host of an instance logs. \param position of an earlier part; empty: the end of the log.
/// \throws config::Error when it cannot be had, with the reason.
LogPart read_log(const Master& master, const GatewayAccess& access, const std::string& gateway,
                 const std::string& instance, const std::string& position, std::int32_t most_bytes);

}  // namespace iotcloud::master
