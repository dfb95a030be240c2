#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery {

/// A live view of the instances of one driver with their channels, kept up to date by watches. Thread safe.
class DriverDirectory {
 public:
  struct Callbacks {
    /// The channel came, or changed. Its driver is active, and chosen.
    std::function<void(const ChannelRecord&)> on_channel;
    /// The channel went: undeployed, or its driver is no longer active, or no longer chosen.
    std::function<void(const ChannelRecord&)> on_channel_gone;
    /// An instance's record was read, whatever its state (before its channels are reported), or went (nullopt). May be
    /// empty.
    std::function<void(const std::string& instance, std::optional<bool> chosen)> on_verdict{};
  };
  /// Watches `driver` below `paths.sensors`; callbacks (on the registry's dispatcher) concern channels named `channel`
  /// only, all channels when it is empty. What is there already is reported first. The driver need not exist yet.
  /// \param where chooses instances by their records, each again when its own record changes.
  DriverDirectory(Registry& registry, Paths paths, std::string driver, std::string channel, Callbacks callbacks,
                  Selection where = {});
  ~DriverDirectory();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

/// A gateway and whether its process lives.
struct GatewayStatus {
  GatewayRecord record;
  bool alive = false;
  bool draining = false;  ///< takes no new instances; those that it has are stopped
  bool original = false;  ///< of the original system: called, not ordered. Known to a master only
};

/// What is wanted of one instance, and where.
struct PlacedOrder {
  std::string gateway;
  OrderRecord order;
};

/// One-time queries, for the master and tests. \throws RegistryError.
std::vector<DriverRecord> list_drivers(Registry& registry, const Paths& paths);  ///< with their channels
/// What list_drivers() is made of: the paths of all instances; the record in such a node (nullopt: it is gone, or
/// cannot be read); and channels for those records that name none.
std::vector<std::string> list_instances(Registry& registry, const Paths& paths);
std::optional<DriverRecord> driver_of(const std::optional<Node>& node, const std::string& path);
void read_unnamed_channels(Registry& registry, const Paths& paths, std::vector<DriverRecord>& drivers);
std::vector<GatewayStatus> list_gateways(Registry& registry, const Paths& paths);
/// \param gateways ids; empty: of all. Those that are not there have none.
std::vector<PlacedOrder> list_orders(Registry& registry, const Paths& paths, const std::vector<std::string>& gateways);
struct TopologyStatus {
  TopologyRecord record;
  std::optional<TopologyOrder> order;  ///< nullopt: nobody ordered anything
  std::vector<WorkerRecord> workers;   ///< that live
};
std::vector<TopologyStatus> list_topologies(Registry& registry, const Paths& paths);
std::vector<WorkerRecord> list_workers(Registry& registry, const Paths& paths, const std::string& topology);

/// Removes all that stands of a topology that nobody runs any more, its orders included.
/// \return false, with nothing but end reports removed, while there are workers. \throws RegistryError.
bool remove_topology(Registry& registry, const Paths& paths, const std::string& topology, const Fence& fence = {});

}  // namespace iotcloud::discovery
