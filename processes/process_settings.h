#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/places.h>
#include <iotcloud/processes/restarts.h>

namespace iotcloud::processes {

/// TCP ports that processes may connect to, by the code that they run (a plugin's file, say); those of `every_code` are
/// for all. Empty: processes connect to whatever they like.
using PortsByCode = std::map<std::string, std::vector<std::uint16_t>>;
inline constexpr const char* every_code = "all";

/// Places to which processes may connect, in the same way.
using PlacesByCode = std::map<std::string, std::vector<Place>>;

/// How a daemon's configuration file speaks of the processes that it confines.
struct ConfinementWords {
  std::string prefix;     ///< of the keys: "host_"
  std::string daemon;     ///< "a gateway"
  std::string processes;  ///< "driver hosts"
  std::string one;        ///< "a driver host"
  /// The name of the shipped units by which systemd starts processes of another user, and of that user: "iotcloud-host"
  std::string unit;
};

/// Reads `<prefix>starter`: the socket at which systemd starts processes as `<prefix>user`; empty: nowhere.
std::string read_starter(config::YamlSection& file, const ConfinementWords& words);

/// Reads `<prefix>user`, `<prefix>open_files`, `<prefix>processes`, `<prefix>files`, `<prefix>call_filter` and
/// `<prefix>debugging`, and checks now, rather than when the first process is started, that this machine allows it.
/// \param starter of read_starter()
Confinement read_confinement(config::YamlSection& file, const ConfinementWords& words, const std::string& starter);

/// Reads `<prefix>ports`, and checks that this machine can restrict connections.
PortsByCode read_ports(config::YamlSection& file, const ConfinementWords& words, const Confinement& confinement);

/// The ports for processes that run this code; nullopt: no restriction.
std::optional<std::vector<std::uint16_t>> ports_of(const PortsByCode& ports, const std::string& code);

/// Reads `<prefix>network`, and checks that this machine can restrict connections.
PlacesByCode read_network(config::YamlSection& file, const ConfinementWords& words, const Confinement& confinement);

/// The places for processes that run this code; nullopt: no restriction.
std::optional<std::vector<Place>> places_of(const PlacesByCode& places, const std::string& code);

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
