#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>

namespace iotcloud::topology::internal {

/// A name that becomes part of registry paths and topics. \throws config::ConfigError.
std::string require_name(config::Section& section, const std::string& key);

/// What spouts and bolts that face a broker have in common. \throws config::ConfigError.
EndpointDefinition read_endpoint(config::Section& section, const std::vector<std::string>& brokers);
/// Their `properties`. \throws config::ConfigError.
void read_reading_options(config::Section& section, ReadingOptions& options);
void read_sending_options(config::Section& section, SendingOptions& options);

}  // namespace iotcloud::topology::internal
