#pragma once

#include <chrono>
#include <map>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry.h>

/// The keys of a topology's file for the registry and the brokers, for other programs that use both, too.
namespace iotcloud::topology {

/// The registry; its URL is that of `registry`, or else of zk.servers; empty: the file names none.
/// \throws config::ConfigError.
discovery::RegistryOptions read_registry(config::YamlSection& root);
/// `zk.root`. \throws config::ConfigError.
std::string read_zk_root(config::YamlSection& root);
/// Brokers by logical name: a URL, or a mapping of connection options. Without credentials both may leave the URL to
/// the channels' records. \throws config::ConfigError.
std::map<std::string, brokers::BrokerOptions> read_brokers(config::YamlSection& root,
                                                           std::chrono::milliseconds session_timeout);

}  // namespace iotcloud::topology
