#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/thrift/listen_settings.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::master {

/// config/master.yaml, read and checked.
struct MasterDaemonConfig {
  std::string id;
  discovery::RegistryOptions registry;
  std::string sensors_root;  ///< zk.root
  config::ListenSettings api{"127.0.0.1", 12904, {}, "", ""};
  config::ListenSettings gateways{"127.0.0.1", 12903, {}, "", ""};  ///< of the original system: on loopback
  std::string gateway_token_file;                                   ///< what gateways are shown; empty: nothing
  std::string audit_file;                                           ///< empty: no audit log
  std::string metrics_address;                                      ///< host:port; empty: no metrics over HTTP
  std::chrono::milliseconds outcome_timeout{30'000};
  bool record_for_lost_gateways = true;
};

/// \throws config::ConfigError
MasterDaemonConfig load_master_config(const std::string& file);

/// The master daemon's parts: registry, master and its Thrift servers.
std::unique_ptr<config::Service> make_master_service(MasterDaemonConfig config);

}  // namespace iotcloud::master
