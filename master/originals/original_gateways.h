#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/direct_gateways.h>

namespace iotcloud::master {

struct OriginalGatewaysOptions {
  discovery::Paths paths;
  std::chrono::milliseconds heartbeat_interval{500};  ///< as the original's master
  std::chrono::milliseconds heartbeat_limit{2'000};   ///< for one answer
  int misses_until_lost = 4;                          ///< in a row; one answer brings the gateway back
};

/// Gateways of the original system. They register by Thrift and know no registry, so the leading master writes their
/// records, keeps them alive in the registry while they answer heartbeats, and calls them with orders. What is known of
/// them stands in the registry: a master that comes to lead tends those that registered with an earlier one.
/// Each has a thread of its own, so that one that hangs delays no other. Thread safe.
class OriginalGateways final : public DirectGateways {
 public:
  /// \param registry outlives this.
  OriginalGateways(discovery::Registry& registry, OriginalGatewaysOptions options);
  /// Their nodes below .../alive go with it.
  ~OriginalGateways() override;

  /// Begins to tend gateways while `leading` says so; it is asked at every heartbeat.
  void start(std::function<bool()> leading);
  /// Ends tending; called before what `leading` uses goes.
  void stop();

  /// What TMasterService brings. \return what was wrong, and how to mend it; empty: done. Nothing throws.
  std::string register_gateway(discovery::GatewayRecord record);
  std::string unregister_gateway(const std::string& gateway);
  std::string put_driver(const std::string& gateway, discovery::DriverRecord record);
  std::string remove_driver(const std::string& gateway, const std::string& instance);

  bool has(const std::string& gateway) const override;
  /// `done` only when the gateway has registered the new instance; the outcome has its id.
  InstanceOutcome deploy(const std::string& gateway, const DeployRequest& request,
                         std::chrono::milliseconds limit) override;
  InstanceOutcome change(const std::string& gateway, const std::string& instance, Change change,
                         std::chrono::milliseconds limit) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
