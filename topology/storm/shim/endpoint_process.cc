#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/storm/shim/endpoint_process.h>
#include <iotcloud/topology/worker/left_behind.h>

namespace iotcloud::topology::storm {

EndpointProcess::EndpointProcess(const TopologyDefinition& definition)
    : registry_options_(definition.registry), services_(make_endpoint_services(definition, nullptr, nullptr)) {
  services_->engine = discovery::engine_storm;
}

EndpointFactories EndpointProcess::factories() const {
  return endpoint_factories(services_);
}

void EndpointProcess::complete(const Topology& topology) {
  services_->keepers = keepers_by_spout(topology);
}

void EndpointProcess::begin() {
  const config::MutexLock lock(mutex_);
  ++tasks_;
  if (registry_) return;
  registry_ = discovery::make_registry(registry_options_);
  services_->registry = registry_.get();
  heart_.emplace(*services_->fence, longest_standstill(*services_));
}

void EndpointProcess::prepare_end() {
  for (const auto& prepare : services_->before_stop) prepare();
}

void EndpointProcess::end() {
  const config::MutexLock lock(mutex_);
  if (--tasks_ > 0) return;
  for (const auto& clear_up : services_->after_stop) clear_up();
  heart_.reset();
  services_->registry = nullptr;
  registry_.reset();
}

}  // namespace iotcloud::topology::storm
