#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/master_options.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/master/orders/backup_file.h>
#include <iotcloud/master/orders/order_kinds.h>
#include <iotcloud/master/topologies/topology_orders.h>

namespace iotcloud::master {

/// The gateway master: turns people's requests into orders in the registry, and answers when it knows the orders'
/// outcomes. All state is in the registry, so a master may die and another take its place at any time. Several masters
/// on one registry elect a leader; the others answer reads and refuse orders.
///
/// Thread safe. Calls block: reads for the registry's operation time-out at most, orders for their wait limit on top.
/// Does not use Thrift: a gateway only has to follow its orders in the registry (discovery::OrderRecord).
class Master {
 public:
  /// Stands for election at once. \param registry outlives the master.
  Master(discovery::Registry& registry, MasterOptions options);
  /// Calls close(), and waits until the last order has returned.
  ~Master();
  Master(const Master&) = delete;
  Master& operator=(const Master&) = delete;

  /// Orders never throw. Outcomes are waited for in parallel: a slow gateway delays no other's order.
  OrderResult deploy(const DeployRequest& request);
  OrderResult undeploy(const InstanceSelection& selection);
  OrderResult start(const InstanceSelection& selection);
  OrderResult stop(const InstanceSelection& selection);
  /// Outcomes are `done` when the gateways have written the changes into the instances' records. A value that the
  /// driver itself reports for a key takes precedence.
  OrderResult update_metadata(const InstanceSelection& selection, const MetadataChanges& changes);
  OrderResult change_deployment(const DeploymentChange& change);
  /// Marks gateways as draining, and stops their instances. A deployment to all gateways skips a draining gateway, one
  /// that names it is refused, and an instance that is started there starts after undrain(). undrain() removes the
  /// mark, and starts again what drain() stopped. Both may be repeated.
  OrderResult drain(const GatewaySelection& selection);
  OrderResult undrain(const GatewaySelection& selection);
  /// Gives instances another version of their plugin, one gateway (or `at_once` instances) after the other. Each must
  /// return to its state, active or inactive. When one does not, it and all that were updated before it go back, and
  /// their outcomes are `failed`. Each instance's order always names the version that it is to run: when this master
  /// ends in the middle, each instance keeps the version that it has by then, and the same update can be ordered again.
  OrderResult update(const UpdateRequest& request);
  /// Takes any order as JSON, by the name of its kind (orders/order_kinds.h); also those that have no method here.
  /// \param before called with the order in words before it is given; what it throws refuses the order.
  GivenOrder give(const std::string& order, const std::string& json, const BeforeOrder& before = {});
  /// Gives an order to a topology, and answers when all workers that run now have followed it or, for a kill, ended.
  TopologyResult order(const TopologyRequest& request);

  /// Why this master takes no orders now; nullopt: it takes them. Does not throw.
  std::optional<OrderResult> refusal() const;

  /// \throws discovery::RegistryError when the registry is away.
  std::vector<discovery::DriverRecord> drivers() const;
  /// drivers(), and lost_orders() after them.
  std::vector<discovery::DriverRecord> drivers_and_lost_orders() const;
  std::vector<discovery::GatewayStatus> gateways() const;
  std::vector<discovery::TopologyStatus> topologies() const;
  std::vector<discovery::PoolRecord> pools() const;
  /// What was ordered for a submitted topology; empty for another one.
  discovery::TopologyHistory history(const discovery::TopologyName& topology) const;
  /// The orders of all instances; gateways of the original system have none.
  std::vector<discovery::PlacedOrder> orders() const;
  /// Everything that is ordered, for the order "import".
  Backup backup() const;
  MasterStatus status() const;  ///< does not throw

  /// Ends all waiting, so that the master can stop quickly: orders under way answer `unknown` at once, and so do later
  /// ones.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
