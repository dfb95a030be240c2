#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/orders/leadership.h>

namespace iotcloud::master {

/// An instance's gateway, driver and record, as the registry has them.
struct Located {
  discovery::InstanceId instance;
  discovery::GatewayId gateway;
  discovery::DriverName driver;           ///< empty: no record yet
  std::optional<discovery::Node> record;  ///< nullopt: no record yet
};

/// Finds the gateway with that id; nullptr: there is none.
const discovery::GatewayStatus* find(const std::vector<discovery::GatewayStatus>& gateways,
                                     const discovery::GatewayId& id);
/// The refusal of a gateway that is not registered, naming those that are.
OrderResult refuse_gateway(const discovery::GatewayId& id, const std::vector<discovery::GatewayStatus>& known);

/// A worker that says it has followed a later order to its topology is not believed: there must be room for the next.
inline constexpr std::int64_t most_revision = std::int64_t{1} << 62;

/// The orders of instances as they stand in the registry. Thread safe; \throws discovery::RegistryError.
class OrderBook {
 public:
  using Seal = std::function<std::string(const std::string& path, const std::string& bytes)>;
  using IsSealed = std::function<bool(const std::string& path, const std::string& bytes)>;
  /// The references outlive this. \param seal MasterOptions::seal \param is_sealed MasterOptions::is_sealed
  OrderBook(discovery::Registry& registry, const discovery::Paths& paths, const Leadership& leadership,
            const Seal& seal, const IsSealed& is_sealed)
      : registry_(registry), paths_(paths), leadership_(leadership), seal_(seal), is_sealed_(is_sealed) {}

  /// Finds the instances that have a record, or an order on a gateway in `known`. Takes the same few rounds of reads
  /// however many instances there are.
  std::map<discovery::InstanceId, Located> locate(const std::set<discovery::InstanceId>& instances,
                                                  const std::vector<discovery::GatewayStatus>& known);

  /// Finds all selected instances. Called before the first order is written, so that a mistyped id changes nothing.
  /// \return a refusal; nullopt: all were found and are in `instances`.
  std::optional<OrderResult> find_selected(const InstanceSelection& selection,
                                           const std::vector<discovery::GatewayStatus>& known,
                                           std::vector<Located>& instances);

  /// The instance's present order; nullopt: there is none.
  std::optional<discovery::OrderRecord> get(const discovery::GatewayId& gateway, const discovery::InstanceId& instance);
  void create(const discovery::GatewayId& gateway, discovery::OrderRecord order, const discovery::Lead& lead);
  MaybeVerdict remove(const Located& where, const discovery::Lead& lead);
  /// Whether to sign what is left of an order after a change, if no trusted master signed the order: only when nothing
  /// of it is left.
  enum class Standing { is_kept, is_replaced };
  /// Changes an existing order. Reads it and changes it again when another write came in between.
  MaybeVerdict rewrite(const Located& where, const discovery::Lead& lead,
                       const std::function<void(discovery::OrderRecord&)>& alter,
                       Standing standing = Standing::is_kept);
  /// The bytes for the node at that path, signed if this master signs.
  std::string sealed(const std::string& path, const std::string& bytes) const {
    return seal_ ? seal_(path, bytes) : bytes;
  }
  bool seals() const { return static_cast<bool>(seal_); }
  /// Whether this master may sign what it makes of these bytes.
  bool is_ours(const std::string& path, const std::string& bytes) const {
    return !is_sealed_ || is_sealed_(path, bytes);
  }

 private:
  void announce_removal(const Located& where, const discovery::OrderRecord* order, const discovery::Lead& lead);
  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Leadership& leadership_;
  const Seal& seal_;
  const IsSealed& is_sealed_;
};

/// ZooKeeper refuses nodes above 1 MiB; an order near that is a mistake.
inline constexpr std::size_t largest_order = std::size_t{512} * 1024;

}  // namespace iotcloud::master
