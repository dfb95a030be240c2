#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>

namespace iotcloud::topology::internal {

/// Reads a name that becomes part of registry paths and topics. \throws config::ConfigError.
std::string require_name(config::YamlSection& section, const std::string& key);

/// Reads the keys that spouts and bolts with a broker share. \throws config::ConfigError.
EndpointDefinition read_endpoint(config::YamlSection& section, const std::vector<std::string>& brokers);
/// Reads the `properties` of a spout that reads from a broker. \throws config::ConfigError.
void read_reading_options(config::YamlSection& section, ReadingOptions& options);
/// Reads the `properties` of a bolt that sends to a broker. \throws config::ConfigError.
void read_sending_options(config::YamlSection& section, SendingOptions& options);

}  // namespace iotcloud::topology::internal
