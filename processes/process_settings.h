#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/restarts.h>

namespace iotcloud::processes {

/// TCP ports that processes may connect to, by the code that they run (a plugin's file, say); those of `every_code` are
/// for all. Empty: processes connect to whatever they like.
using PortsByCode = std::map<std::string, std::vector<std::uint16_t>>;
inline constexpr const char* every_code = "all";

/// How a daemon's configuration file speaks of the processes that it confines.
struct ConfinementWords {
  std::string prefix;     ///< of the keys: "host_"
  std::string daemon;     ///< "a gateway"
  std::string processes;  ///< "driver hosts"
  std::string one;        ///< "a driver host"
  /// What to do instead of running the daemon as root, to have processes of another user; empty: they have the daemon's
  /// user, and there is no key `<prefix>user`.
  std::string instead_of_root;
};

/// Reads `<prefix>user`, `<prefix>open_files`, `<prefix>processes`, `<prefix>files`, `<prefix>call_filter` and
/// `<prefix>debugging`, and checks now, rather than when the first process is started, that this machine allows it.
/// \param started_for_us somebody who may start processes of another user does so for this daemon
Confinement read_confinement(config::YamlSection& file, const ConfinementWords& words, bool started_for_us);

/// Reads `<prefix>ports`, and checks that this machine can restrict connections.
PortsByCode read_ports(config::YamlSection& file, const ConfinementWords& words, const Confinement& confinement);

/// The ports for processes that run this code; nullopt: no restriction.
std::optional<std::vector<std::uint16_t>> ports_of(const PortsByCode& ports, const std::string& code);

/// Reads `<prefix>log`, with `limit_mb` and `kept`: how long a process' log grows, and how many older ones stay.
void read_log_limits(config::YamlSection& file, const std::string& prefix, int& limit_mb, int& kept);

/// Reads `<prefix>restart`, with `first`, `longest`, `healthy_after` and `give_up_after`.
void read_restarts(config::YamlSection& file, const std::string& prefix, RestartPolicy& policy);

/// Reads a duration, in whole milliseconds.
void read_time(config::YamlSection& section, const std::string& key, std::chrono::milliseconds& value);

/// What every program reads: libraries, names of hosts and accounts, the system's certificates, itself in /proc. The
/// folder of our own configuration is not among it.
const std::vector<std::string>& readable_by_all();

}  // namespace iotcloud::processes
