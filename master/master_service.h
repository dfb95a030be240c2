#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::master {

/// Where one Thrift service of the master listens.
struct ListenAddress {
  std::string host = "127.0.0.1";
  int port = 0;
};

/// config/master.yaml, read and checked.
struct MasterDaemonConfig {
  std::string id;
  discovery::RegistryOptions registry;
  std::string sensors_root;  ///< zk.root
  ListenAddress api{"127.0.0.1", 12904};
  ListenAddress gateways{"127.0.0.1", 12903};
  std::string token;            ///< api.token_file's first line; empty: none is asked for
  std::string metrics_address;  ///< host:port; empty: no metrics over HTTP
  std::string advertise;        ///< host:port of the API as others reach it
  std::chrono::milliseconds outcome_timeout{30'000};
  bool record_for_lost_gateways = true;
};

/// \throws config::ConfigError
MasterDaemonConfig load_master_config(const std::string& file);

/// The master daemon's parts: registry, master and its Thrift servers.
std::unique_ptr<config::Service> make_master_service(MasterDaemonConfig config);

}  // namespace iotcloud::master
