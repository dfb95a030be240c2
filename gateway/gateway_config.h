#pragma once

#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/fleet/process_launcher.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/site_service.h>

namespace iotcloud::gateway {

/// The gateway daemon's configuration file, read and checked (config/gateway.yaml describes the keys).
struct GatewayConfig {
  GatewayOptions gateway;  ///< `registry` and `launcher` are not set
  discovery::RegistryOptions registry;
  ProcessLauncher::Options hosts;                ///< `trust` is set, `store` is not
  std::shared_ptr<security::TrustedKeys> trust;  ///< the keys whose signatures on plugins are trusted
  std::int64_t plugin_upload_limit = 0;          ///< the largest uploaded plugin, in bytes
  SiteService::Options thrift;
  std::string metrics_address;  ///< host:port; empty: no metrics page

  /// \throws config::ConfigError with file, line, key and remedy.
  static GatewayConfig load(const std::string& file);
};

}  // namespace iotcloud::gateway
