#pragma once

#include <map>
#include <string>

namespace iotcloud::fuzz {

/// A target's first inputs, by their names.
using SeedsOfTarget = std::map<std::string, std::string>;
/// By the targets' names.
using Seeds = std::map<std::string, SeedsOfTarget>;

/// The first inputs of all targets, made by the project's own encoders.
Seeds all_seeds();

/// Adds calls of the Thrift services, as clients write them, one or several on a connection, and manifests.
void add_control_plane_seeds(Seeds& seeds);
/// Adds what goes between gateway, driver host and what starts it, headers of Kafka records, HTTP, tuples, signatures
/// and audit lines.
void add_wire_seeds(Seeds& seeds);
/// Adds what devices announce of themselves, and answers of mDNS and WS-Discovery.
void add_device_seeds(Seeds& seeds);

}  // namespace iotcloud::fuzz
