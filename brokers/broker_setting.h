#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/yaml.h>

namespace iotcloud::brokers {

/// A logical broker of a configuration file.
struct BrokerSetting {
  std::string name;       ///< the name that drivers, channel records and topologies use: "rabbitmq"
  std::string type;       ///< a kind of broker (broker_kinds()); empty: the URLs decide
  BrokerOptions options;  ///< without clock and metrics
};

/// Reads a broker's connection options from a section of YAML: `urls`, `user`, `password_file`, `password_variable`,
/// `tls: {ca, certificate, key, revoked}`, `heartbeat`, `properties`. The caller reads its own keys and finishes the
/// section. `urls` may be missing.
/// \param session_timeout of the registry: the broker must notice a dead reader before the registry names another one,
/// so the heartbeat is at most half of it.
/// \throws config::ConfigError for impossible values, with file, line and remedy.
BrokerOptions read_broker_options(config::YamlSection& section, std::chrono::milliseconds session_timeout);

/// The files that the broker's client reads, by their keys in the section: passwords, that of RabbitMQ's user for
/// reading too, certificates and the key. read_broker_options() has found them all.
std::map<std::string, std::string> files_of(const BrokerOptions& options);
/// Hands each of these files to a function, which may put another path in its place.
void change_files(BrokerOptions& options, const std::function<void(std::string& file)>& change);

/// Whether the options hold something that only the intended broker may get (a user, the place of a password, a client
/// certificate), or an authority by which that broker proves itself. Such options must not be used with an address that
/// somebody else names.
bool are_credentials_given(const BrokerOptions& options);

/// The default heartbeat. A server disconnects a silent client after two to three heartbeats, and a topic's next reader
/// must start within the session's time-out plus two seconds.
std::chrono::milliseconds usual_heartbeat(std::chrono::milliseconds session_timeout);

}  // namespace iotcloud::brokers
