#pragma once

#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// The factories of the spouts and bolts that face brokers. The components connect when the topology starts, so the
/// caller may fill `services` until then.
EndpointFactories endpoint_factories(EndpointServicesPtr services);

}  // namespace iotcloud::topology
