#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/check/finding.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::check {

/// What one daemon's configuration file names: the file of a gateway, a master, a pool or a topology.
struct Machine {
  std::string file;
  std::string kind;  ///< "gateway", "master", "pool", "topology"
  discovery::RegistryOptions registry{};
  std::string zk_root = "/iot/sensors";
  std::map<std::string, brokers::BrokerOptions> brokers{};
  /// Where it listens: the key, and host and port.
  struct Listener {
    std::string key, host;
    int port = 0;
  };
  std::vector<Listener> listeners{};
  std::vector<std::pair<std::string, security::TlsFiles>> tls{};  ///< by key
  std::vector<std::pair<std::string, std::string>> folders{};     ///< by key: `state`, `plugins`
  std::vector<std::string> secret_files{};                        ///< passwords, tokens and keys that it names
  std::string text{};                                             ///< the file's
};

/// Reads a file as far as it can be read; what cannot is a finding.
Machine read_machine(const std::string& file, Findings& findings);

/// The files of daemons that are usual here: those in a folder whose kind is known.
std::vector<std::string> usual_files(const std::string& folder);

}  // namespace iotcloud::check
