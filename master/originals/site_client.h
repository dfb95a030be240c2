#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <iotcloud/config/thrift/tls.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// Where a gateway's Thrift service is, and how one gets in.
struct SiteAddress {
  std::string host;
  int port = 0;
  config::TlsFiles tls;    ///< empty: it speaks none
  std::string token_file;  ///< its first line is the token; empty: none is shown
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

/// One change of state of one driver instance, as a gateway remembers it.
struct DriverChange {
  std::string gateway;
  std::string instance;
  std::string driver;
  std::string state;
  std::string reason;
  std::int64_t time_ms = 0;  ///< wall time
};

struct LogPart {
  std::string text;
  std::string position;  ///< where to go on
};

/// A plugin's file.
struct PluginOffer {
  std::string plugin;     ///< plain file name
  std::string sha256;     ///< of all its bytes
  std::int64_t size = 0;  ///< bytes
  std::string signature;  ///< empty: not signed
};

/// Questions to a gateway of this system; `limit` is for each answer on the way. Thread safe.
/// \param gateway its id: an address on loopback may lead to another gateway, which is not asked.
/// \throws config::Error with the gateway's own words, or why it could not be asked.
std::vector<DriverChange> site_changes(const SiteAddress& site, const std::string& gateway, const std::string& instance,
                                       std::chrono::milliseconds limit);
LogPart site_read_log(const SiteAddress& site, const std::string& gateway, const std::string& instance,
                      const std::string& position, std::int32_t most_bytes, std::chrono::milliseconds limit);

/// A plugin that is sent to a gateway (gateway.thrift). The same way; \return the upload's id, empty when the gateway
/// has the plugin already.
std::string site_offer_plugin(const SiteAddress& site, const std::string& gateway, const PluginOffer& offer,
                              std::chrono::milliseconds limit);
void site_send_plugin(const SiteAddress& site, const std::string& gateway, const std::string& upload,
                      std::int64_t offset, const std::string& bytes, std::chrono::milliseconds limit);
void site_finish_plugin(const SiteAddress& site, const std::string& gateway, const std::string& upload,
                        std::chrono::milliseconds limit);

}  // namespace iotcloud::master
