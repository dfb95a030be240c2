#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <iotcloud/discovery/carried_messages.h>
#include <iotcloud/discovery/channel_look.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::master {

/// The address of a gateway's Thrift service, and the credentials for it.
struct SiteAddress {
  std::string host;
  int port = 0;
  security::TlsFiles tls;  ///< empty: it does not speak TLS
  std::string token_file;  ///< its first line is the token, sent with TLS only; empty: no token is sent
};

/// The token in the first line of a file. \throws config::Error if there is none.
std::string token_in(const std::string& file);

/// A gateway's answer to a call.
struct SiteAnswer {
  OrderOutcome outcome = OrderOutcome::unknown;  ///< done: it answered SUCCESS; unknown: no answer came in time
  std::string text;                              ///< the gateway's own words, or what went wrong
};

/// Call TSensorSiteService, each time on a new connection. Thread safe; they do not throw.
SiteAnswer site_heartbeat(const SiteAddress& site, std::chrono::milliseconds limit);
SiteAnswer site_deploy(const SiteAddress& site, const DeployRequest& request, std::chrono::milliseconds limit);
SiteAnswer site_change(const SiteAddress& site, const discovery::InstanceId& instance, InstanceAction action,
                       std::chrono::milliseconds limit);

/// Ask a gateway of this system, not of the original; `limit` holds for each answer that a call needs. Thread safe.
/// \param gateway the id that the gateway must have: an address on loopback may lead to another gateway, which is then
/// not asked.
/// \throws config::Error with the gateway's own words, or why it could not be asked.
std::vector<DriverChange> site_changes(const SiteAddress& site, const discovery::GatewayId& gateway,
                                       const discovery::InstanceId& instance, std::chrono::milliseconds limit);
std::vector<GatewayPlugin> site_plugins(const SiteAddress& site, const discovery::GatewayId& gateway,
                                        std::chrono::milliseconds limit);
std::vector<discovery::CarriedMessages> site_carried(const SiteAddress& site, const discovery::GatewayId& gateway,
                                                     std::chrono::milliseconds limit);
LogPart site_read_log(const SiteAddress& site, const discovery::GatewayId& gateway,
                      const discovery::InstanceId& instance, const std::string& position, std::int32_t most_bytes,
                      std::chrono::milliseconds limit);

discovery::ChannelLook site_look_at_channel(const SiteAddress& site, const discovery::GatewayId& gateway,
                                            const discovery::LookRequest& request, std::chrono::milliseconds limit);
discovery::ChannelLook site_hand_message(const SiteAddress& site, const discovery::GatewayId& gateway,
                                         const discovery::HandedMessage& message, std::chrono::milliseconds limit);

/// Send a plugin to a gateway (gateway.thrift), under the same rules. \return the upload's id; empty when the gateway
/// has the plugin already.
std::string site_offer_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const PluginOffer& offer,
                              std::chrono::milliseconds limit);
void site_send_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const std::string& upload,
                      std::int64_t offset, const std::string& bytes, std::chrono::milliseconds limit);
void site_finish_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const std::string& upload,
                        std::chrono::milliseconds limit);

}  // namespace iotcloud::master
