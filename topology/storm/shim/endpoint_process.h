#pragma once

#include <memory>
#include <optional>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/endpoints/services.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology::storm {

/// What the spouts and bolts of a topology that face brokers share in one of Storm's workers: the registry's session,
/// the brokers' clients, the fence. To the other workers it is a worker as iotcloud-topology is one, and gets a share
/// of the drivers for its spouts' tasks here. Thread safe.
class EndpointProcess {
 public:
  explicit EndpointProcess(const TopologyDefinition& definition);

  /// To put the graph together; then complete() tells what the endpoints know of it.
  EndpointFactories factories() const;
  void complete(const Topology& topology);

  /// A task of an endpoint begins; the first one connects to the registry. \throws config::Error
  void begin();
  /// It has ended; with the last one the process leaves the registry.
  void end();
  /// Before a task ends.
  void prepare_end();

 private:
  const discovery::RegistryOptions registry_options_;
  const EndpointServicesPtr services_;
  config::Mutex mutex_;
  int tasks_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::unique_ptr<discovery::Registry> registry_ IOTCLOUD_GUARDED_BY(mutex_);
  std::optional<FenceHeart> heart_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology::storm
