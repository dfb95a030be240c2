#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/discovery/submissions.h>

namespace iotcloud::discovery {

/// A live view of one driver's instances and their channels, kept up to date by watches. Of which driver and instance a
/// record is, and the name of a channel, is what the record's place says; records that say something else are skipped
/// and logged, as is the record of a channel on another gateway than its instance. Thread safe.
class DriverDirectory {
 public:
  struct Callbacks {
    /// A channel appeared or changed. Its driver is active and selected.
    std::function<void(const ChannelRecord&)> on_channel;
    /// A channel is gone: undeployed, or its driver is no longer active or selected.
    std::function<void(const ChannelRecord&)> on_channel_gone;
    /// An instance's record was read, whatever its state: `chosen` says whether `where` selects it. Its channels are
    /// reported after this call. nullopt: the record is gone. May be empty.
    std::function<void(const InstanceId& instance, std::optional<bool> chosen)> on_choice{};
    /// The same, with what the record says, whether `where` selects the instance or not. May be empty.
    /// \param record null: the record is gone; valid during the call only
    std::function<void(const InstanceId& instance, const DriverRecord* record, bool chosen)> on_record{};
    /// The record of an active, selected instance names its channels, and the wanted one is not among them. May be
    /// empty.
    std::function<void(const InstanceId& instance, const std::vector<ChannelRecord>& channels)> on_missing{};
  };
  /// Watches `driver` below `paths.sensors`. The callbacks run on the registry's dispatcher and concern channels named
  /// `channel` only (all channels if it is empty). Existing channels are reported first. The driver need not exist yet.
  /// \param where selects instances by their records, again after each change of a record.
  DriverDirectory(Registry& registry, Paths paths, DriverName driver, std::string channel, Callbacks callbacks,
                  Selection where = {});
  ~DriverDirectory();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

/// A gateway, and whether its process lives.
struct GatewayStatus {
  GatewayRecord record;
  bool alive = false;
  std::string frozen{};   ///< why it follows no orders (freeze.h); empty: it follows them
  bool draining = false;  ///< takes no new instances, and has stopped its own
  bool original = false;  ///< a gateway of the original system, which the master calls instead; set by the master
  static constexpr const char* what = "the status of a gateway";
  static constexpr auto fields =
      std::tuple_cat(IOTCLOUD_FIELDS_OF(record, GatewayRecord),
                     std::tuple{IOTCLOUD_FIELD(alive, usual), IOTCLOUD_FIELD(frozen, rare),
                                IOTCLOUD_FIELD(draining, usual), IOTCLOUD_FIELD(original, usual)});
};

/// An order and its gateway.
struct PlacedOrder {
  GatewayId gateway;
  OrderRecord order;
};

/// One-time queries, for the master and tests. Ids of gateways and instances and names of drivers are those of the
/// nodes' paths, whatever the records there say: a record that somebody has forged is that of its own place only.
/// \throws RegistryError.
std::vector<DriverRecord> list_drivers(Registry& registry, const Paths& paths);  ///< with their channels
/// The first step of list_drivers(): the paths of all instances' nodes. The next steps are driver_of() for each node,
/// and read_unnamed_channels().
std::vector<std::string> list_instances(Registry& registry, const Paths& paths);
/// The record of an instance in a node at `path`; nullopt: the node is gone, or its bytes are no record.
std::optional<DriverRecord> driver_of(const std::optional<Node>& node, const std::string& path);
/// Reads the channels of those records that name none, as the original's gateways write them. \throws RegistryError.
void read_unnamed_channels(Registry& registry, const Paths& paths, std::vector<DriverRecord>& drivers);
/// All gateways that have a record, alive or not. \throws RegistryError.
std::vector<GatewayStatus> list_gateways(Registry& registry, const Paths& paths);
/// What a node does that keeps this process out.
enum class Unreadable { left_out, throws };
/// \param gateways empty: all gateways. Unknown gateways have no orders. \throws RegistryError.
std::vector<PlacedOrder> list_orders(Registry& registry, const Paths& paths, const std::vector<GatewayId>& gateways,
                                     Unreadable unreadable = Unreadable::left_out);
/// The form of a topology's order as the word for what is wanted: "active", "inactive" or "killed".
struct AsWantedState {
  static std::string to(const std::optional<TopologyOrder>& order);
  static void from(const std::string& word, std::optional<TopologyOrder>& order);
};
/// The form of a topology's order as its revision; 0: there is no order.
struct AsRevision {
  static std::int64_t to(const std::optional<TopologyOrder>& order) { return order ? order->revision : 0; }
  static void from(std::int64_t revision, std::optional<TopologyOrder>& order);
};
/// The form of workers as their names, from which no worker is read.
struct AsWorkerNames {
  static std::vector<std::string> to(const std::vector<WorkerRecord>& workers);
  static void from(const std::vector<std::string>& /*names*/, std::vector<WorkerRecord>& /*workers*/) {}
};

/// A topology that somebody runs, or that has orders.
struct TopologyStatus {
  TopologyRecord record;
  /// nullopt: there is no order. A status that has travelled has an order, of which only the revision and what is
  /// wanted are known.
  std::optional<TopologyOrder> order;
  std::vector<WorkerRecord> workers;  ///< live workers
  /// Of a topology that was submitted to pools; else 0 and empty.
  std::int64_t version = 0;  ///< TopologyVersion::number
  std::string digest{};      ///< TopologyVersion::digest
  int wanted_workers = 0;
  std::string manager{};              ///< Submission::manager
  std::vector<PlaceStatus> places{};  ///< what pools report, sorted by place
  static constexpr const char* what = "the status of a topology";
  static constexpr auto fields = std::tuple_cat(
      IOTCLOUD_FIELDS_OF(record, TopologyRecord),
      std::tuple{IOTCLOUD_FIELD_IN(AsWorkerNames, workers, usual, "worker_names", workers),
                 IOTCLOUD_FIELD_AS(workers, usual, "workers", workerRecords),
                 IOTCLOUD_FIELD_IN(AsWantedState, order, usual, "wanted", wanted),
                 IOTCLOUD_FIELD_IN(AsRevision, order, usual, "revision", revision), IOTCLOUD_FIELD(version, rare),
                 IOTCLOUD_FIELD(digest, rare), IOTCLOUD_FIELD_AS(wanted_workers, rare, "wanted_workers", wantedWorkers),
                 IOTCLOUD_FIELD(manager, rare), IOTCLOUD_FIELD(places, rare)});
};
/// All topologies that run, have orders or are submitted, with their orders and workers. \throws RegistryError.
std::vector<TopologyStatus> list_topologies(Registry& registry, const Paths& paths);
/// The workers that live. \throws RegistryError.
std::vector<WorkerRecord> list_workers(Registry& registry, const Paths& paths, const TopologyName& topology);

/// Removes all nodes of a topology that nobody runs any more, its orders included, but for its history and the mark
/// that its submission was killed, by which a pool that was cut off meanwhile knows that it ended. \return false, with
/// nothing but end reports removed, while workers live. \throws RegistryError.
bool remove_topology(Registry& registry, const Paths& paths, const TopologyName& topology, const Fence& fence = {});

}  // namespace iotcloud::discovery
