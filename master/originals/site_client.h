#pragma once

#include <chrono>
#include <string>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// Where a gateway's Thrift service is.
struct SiteAddress {
  std::string host;
  int port = 0;
};

/// What a gateway made of a call.
struct SiteAnswer {
  Outcome outcome = Outcome::unknown;  ///< done: it answered SUCCESS; unknown: nothing came in time
  std::string text;                    ///< its own words, or what went wrong
};

/// Calls of TSensorSiteService, each on a connection of its own. Thread safe; nothing throws.
SiteAnswer site_heartbeat(const SiteAddress& site, std::chrono::milliseconds limit);
SiteAnswer site_deploy(const SiteAddress& site, const DeployRequest& request, std::chrono::milliseconds limit);
SiteAnswer site_change(const SiteAddress& site, const std::string& instance, Change change,
                       std::chrono::milliseconds limit);

}  // namespace iotcloud::master
