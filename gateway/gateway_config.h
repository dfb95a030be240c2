#pragma once

#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/fleet/process_launcher.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/site_service.h>
#include <iotcloud/rpc/http/page_settings.h>

namespace iotcloud::gateway {

/// The gateway daemon's configuration file, read and checked (config/gateway.yaml describes the keys).
struct GatewayConfig {
  GatewayOptions gateway;  ///< `registry` and `launcher` are not set
  discovery::RegistryOptions registry;
  ProcessLauncher::Options hosts;                ///< `trust` is set, `store` is not
  std::shared_ptr<security::TrustedKeys> trust;  ///< the keys whose signatures on plugins are trusted
  std::shared_ptr<security::TrustedKeys>
      order_keys;                        ///< the masters' keys, also in `gateway`; null: none are asked for
  std::string provisioning_file;         ///< whose rules are in `gateway`; empty: there is none
  std::int64_t plugin_upload_limit = 0;  ///< the largest uploaded plugin, in bytes
  SiteService::Options thrift;           ///< `audit` is not set
  security::AuditSettings audit;  ///< of the orders to the Thrift service and, if they are signed, in the registry
  rpc::PageSettings pages;        ///< /metrics and /healthz

  /// \throws config::ConfigError with file, line, key and remedy.
  static GatewayConfig load(const std::string& file);
};

}  // namespace iotcloud::gateway
