#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/gateways/gateway_access.h>

namespace iotcloud::master {

SiteAddress address_of(const discovery::GatewayStatus& gateway, const GatewayAccess& access) {
  if (!gateway.alive) throw config::Error(fmt::format("gateway {} is lost", gateway.record.id));
  if (gateway.record.port == 0) {
    throw config::Error(
        fmt::format("gateway {} has no Thrift service; give it one (thrift: {{port: 12905}})", gateway.record.id));
  }
  if (!gateway.record.tls) return {gateway.record.host, gateway.record.port, {}, ""};
  if (access.tls.empty()) {
    throw config::Error(
        fmt::format("gateway {} speaks TLS, and this master has no certificate; give it one "
                    "(api: {{tls: {{ca, certificate, key}}}})",
                    gateway.record.id));
  }
  return {gateway.record.host, gateway.record.port, access.tls, access.token_file};
}

}  // namespace iotcloud::master
