#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/direct_gateways.h>

namespace iotcloud::master {

/// How the master sends heartbeats to gateways of the original system.
struct OriginalGatewaysOptions {
  discovery::Paths paths;
  std::chrono::milliseconds heartbeat_interval{500};  ///< the interval of the original's master
  std::chrono::milliseconds heartbeat_limit{2'000};   ///< time limit of one answer
  /// The users of the fleet at the registry, whose gateways are of this system, registered or not; null: unknown.
  std::shared_ptr<const discovery::RegistryAccess> access{};
  int misses_until_lost = 4;  ///< missed answers in a row after which the gateway is lost; one answer brings it back
};

/// Gateways of the original system. They register by Thrift and know no registry, so the leading master writes their
/// records, keeps them alive in the registry while they answer heartbeats, and calls them with orders. All that is
/// known of them is in the registry, so a new leader takes over the gateways that registered with an earlier one. Each
/// gateway has a thread of its own, so that one that hangs delays no other. Thread safe.
class OriginalGateways final : public DirectGateways {
 public:
  /// \param registry outlives this.
  OriginalGateways(discovery::Registry& registry, OriginalGatewaysOptions options);
  /// Removes the gateways' ephemeral .../alive nodes.
  ~OriginalGateways() override;

  /// Starts to look after gateways as long as `leading` returns true; it is called at every heartbeat.
  void start(std::function<bool()> leading);
  /// Stops looking after gateways. Call it before what `leading` uses is destroyed.
  void stop();

  /// The calls of TMasterService. \return what was wrong, and how to mend it; empty: done. They do not throw.
  std::string register_gateway(discovery::GatewayRecord record);
  std::string unregister_gateway(const discovery::GatewayId& gateway);
  std::string put_driver(const discovery::GatewayId& gateway, discovery::DriverRecord record);
  std::string remove_driver(const discovery::GatewayId& gateway, const discovery::InstanceId& instance);

  bool has(const discovery::GatewayId& gateway) const override;
  /// `done` only when the gateway has registered the new instance; the outcome has its id.
  InstanceOutcome deploy(const discovery::GatewayId& gateway, const DeployRequest& request,
                         std::chrono::milliseconds limit) override;
  InstanceOutcome change(const discovery::GatewayId& gateway, const discovery::InstanceId& instance,
                         InstanceAction action, std::chrono::milliseconds limit) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
