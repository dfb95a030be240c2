#pragma once

#include <memory>
#include <string>

#include <iotcloud/config/daemon/daemon.h>

namespace iotcloud::topology {

/// The daemon that `iotcloud-topology --pool` runs, from its configuration file. \throws config::ConfigError
std::unique_ptr<config::DaemonService> make_pool_daemon(const std::string& config_file);

}  // namespace iotcloud::topology
