#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/rpc/http/page_settings.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/pool/pool.h>
#include <iotcloud/topology/pool/pool_service.h>
#include <iotcloud/topology/pool/worker_processes.h>

namespace iotcloud::topology {

/// A pool's configuration file (config/pool.yaml is a commented one).
struct PoolConfig {
  discovery::RegistryOptions registry;
  PoolOptions pool;
  PoolService::Options service;
  WorkerProcesses::Options workers;
  std::int64_t upload_limit = 0;  ///< bytes of one component library
  std::shared_ptr<security::TrustedKeys> library_keys;
  std::shared_ptr<security::TrustedKeys> order_keys;  ///< null: submissions need no signature
  rpc::PageSettings pages;

  /// \throws config::ConfigError with file, line, key and what would be right; also for unknown keys.
  static PoolConfig load(const std::string& path);
};

}  // namespace iotcloud::topology
