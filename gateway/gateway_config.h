#pragma once

#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/processes/process_launcher.h>
#include <iotcloud/gateway/site/site_service.h>

namespace iotcloud::gateway {

/// The gateway daemon's configuration file, read and checked (config/gateway.yaml describes the keys).
struct GatewayConfig {
  GatewayOptions gateway;  ///< without registry and launcher
  discovery::RegistryOptions registry;
  ProcessLauncher::Options hosts;        ///< with `trust`; without the store
  std::shared_ptr<PluginTrust> trust;    ///< whose plugins are trusted
  std::int64_t plugin_upload_limit = 0;  ///< bytes of a plugin that is sent
  SiteService::Options thrift;
  std::string metrics_address;  ///< host:port; empty: none

  /// \throws config::ConfigError with file, line, key and remedy.
  static GatewayConfig load(const std::string& file);
};

}  // namespace iotcloud::gateway
