#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/master/originals/site_client.h>

namespace iotcloud::master {

class Master;

struct DriverHistory {
  std::vector<DriverChange> changes;          ///< the oldest first
  std::map<std::string, std::string> silent;  ///< gateways that could not be asked, and why
};

/// What gateways remember of their instances' states since they started; all are asked at the same time.
/// \param instance empty: of all. \param gateways empty: all that are registered.
/// \throws config::Error when the registry is away or a gateway is not registered.
DriverHistory read_history(const Master& master, const std::string& instance, const std::vector<std::string>& gateways);

/// What the driver host of an instance logs. \param position of an earlier part; empty: the end of the log.
/// \throws config::Error when it cannot be had, with the reason.
LogPart read_log(const Master& master, const std::string& gateway, const std::string& instance,
                 const std::string& position, std::int32_t most_bytes);

}  // namespace iotcloud::master
