#include <string_view>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/master/gateways/gateway_access.h>

namespace iotcloud::master {

SiteAddress address_of(const discovery::GatewayStatus& gateway, const GatewayAccess& access) {
  if (!gateway.alive) throw config::Error(fmt::format("gateway {} is lost", gateway.record.id));
  if (gateway.record.port == 0) {
    throw config::Error(
        fmt::format("gateway {} has no Thrift service; give it one (thrift: {{port: 12905}})", gateway.record.id));
  }
  if (!gateway.record.tls) {
    // Whoever may write a gateway's record could have plugins sent to any address in the clear, and answers of anybody.
    if (!access.tls.empty() && !gateway.original && !config::is_loopback(gateway.record.host)) {
      throw config::Error(fmt::format(
          "gateway {} at {} speaks no TLS, and this master, which has a certificate, calls such gateways on "
          "its own machine only; give it one (thrift: {{tls: {{ca, certificate, key}}}})",
          gateway.record.id, gateway.record.host));
    }
    return {gateway.record.host, gateway.record.port, {}, ""};
  }
  if (access.tls.empty()) {
    throw config::Error(
        fmt::format("gateway {} speaks TLS, and this master has no certificate; give it one "
                    "(api: {{tls: {{ca, certificate, key}}}})",
                    gateway.record.id));
  }
  constexpr std::string_view id = "{gateway}";
  std::string token_file = access.token_file;
  if (const auto at = token_file.find(id); at != std::string::npos)
    token_file.replace(at, id.size(), gateway.record.id.str());
  return {gateway.record.host, gateway.record.port, access.tls, token_file};
}

}  // namespace iotcloud::master
