#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/console/console_settings.h>
#include <iotcloud/rpc/http/page_settings.h>
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::master {

/// The settings of config/master.yaml, checked.
struct MasterDaemonConfig {
  std::string id;
  discovery::RegistryOptions registry;
  std::string sensors_root;  ///< zk.root
  rpc::ListenSettings api{"127.0.0.1", 12904, {}, "", ""};
  /// For gateways of the original system, on loopback only, without TLS and tokens. nullopt: off.
  std::optional<rpc::ListenSettings> gateways;
  std::string gateway_token_file;  ///< GatewayAccess::token_file
  std::string worker_token_file;   ///< WorkerAccess::token_file
  std::string pool_token_file;     ///< PoolAccess::token_file
  security::AuditSettings audit;
  rpc::PageSettings pages;  ///< /metrics and /healthz
  ConsoleSettings console;
  std::string signing_key;  ///< file of the private key that signs orders to gateways; empty: unsigned
  /// The keys of all masters; null: this one signs what it makes of an order, whoever wrote the order.
  std::shared_ptr<security::TrustedKeys> order_keys;
  std::chrono::milliseconds outcome_timeout{30'000};
  bool record_for_lost_gateways = true;
};

/// \throws config::ConfigError
MasterDaemonConfig load_master_config(const std::string& file);

/// The master daemon's parts: registry, master and its Thrift servers.
std::unique_ptr<config::DaemonService> make_master_service(MasterDaemonConfig config);

}  // namespace iotcloud::master
