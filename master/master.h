#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/orders.h>
#include <iotcloud/master/topologies/topology_orders.h>

namespace iotcloud::master {

class DirectGateways;

struct MasterOptions {
  std::string id = "master";  ///< in logs and in `iotcloud status`
  /// host:port of this master's Thrift API, as others reach it: what a standby master names as the leader's address.
  std::string address;
  discovery::Paths paths;
  /// How long an order waits for its outcomes when the caller says nothing.
  std::chrono::milliseconds outcome_timeout{30'000};
  /// An order for a gateway that is lost is recorded and `pending`; with false it is `failed` and not recorded.
  bool record_for_lost_gateways = true;
  DirectGateways* direct = nullptr;  ///< gateways that are called, not ordered; outlives the master; may be null
};

struct MasterStatus {
  std::string id;
  bool leading = false;
  std::int64_t epoch = 0;      ///< of this master's orders; 0 while it does not lead
  std::string leader;          ///< host:port of the master that leads; empty: none, or not known
  bool registry_away = false;  ///< no connection to the registry now
};

/// The gateway master: turns what people want into orders in the registry, and answers when it knows what became of
/// them. All state is in the registry, so a master may die and another take its place at any time. Several masters on
/// one registry elect a leader; the others answer reads and refuse orders.
///
/// Thread safe. Calls block: reads for the registry's operation time-out at most, orders for their wait limit on top.
/// Uses no Thrift; a gateway need only follow its orders (discovery::OrderRecord).
class Master {
 public:
  /// Stands for election at once. \param registry outlives the master.
  Master(discovery::Registry& registry, MasterOptions options);
  /// Calls close() and waits until no order is under way any more.
  ~Master();
  Master(const Master&) = delete;
  Master& operator=(const Master&) = delete;

  /// Orders never throw. Outcomes are waited for in parallel: a slow gateway delays no other's order.
  OrderResult deploy(const DeployRequest& request);
  OrderResult undeploy(const InstanceSelection& selection);
  OrderResult start(const InstanceSelection& selection);
  OrderResult stop(const InstanceSelection& selection);
  /// Done when the gateways have written it into the instances' records. What a driver itself says of a key goes
  /// before.
  OrderResult update_metadata(const InstanceSelection& selection, const MetadataChanges& changes);
  OrderResult change_deployment(const DeploymentChange& change);
  /// Marks gateways as draining and stops their instances: `all` passes such a gateway by, naming it is refused, and
  /// what is started there waits. Undrain ends that; what drain stopped starts again. Both may be repeated.
  OrderResult drain(const GatewaySelection& selection);
  OrderResult undrain(const GatewaySelection& selection);
  /// Gives instances another version of their plugin, one gateway (or `at_once` instances) after the other. Each must
  /// come to what it was, active or inactive; when one does not, it and all that were updated before go back, and their
  /// outcomes are `failed`. What every instance is to run stands in its order at any time: when this master ends in the
  /// middle, each keeps the version that it has by then, and the same update can be given again.
  OrderResult update(const UpdateRequest& request);
  /// The same for a topology: answers when all of its workers that run now have followed, or ended.
  TopologyResult order(const TopologyRequest& request);

  /// Why this master takes no orders now; nullopt: it takes them. Does not throw.
  std::optional<OrderResult> refusal() const;

  /// \throws discovery::RegistryError when the registry is away.
  std::vector<discovery::DriverRecord> drivers() const;
  std::vector<discovery::GatewayStatus> gateways() const;
  std::vector<discovery::TopologyStatus> topologies() const;
  std::vector<discovery::PlacedOrder> orders() const;  ///< what is wanted of every instance; not of the original's
  MasterStatus status() const;                         ///< does not throw

  /// Ends all waiting: orders under way answer `unknown`, later ones too. For a stop in time.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
