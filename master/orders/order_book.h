#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/orders/leadership.h>

namespace iotcloud::master {

/// An instance's gateway, driver and record, as the registry has them.
struct LocatedInstance {
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

/// Remembers when this master gave its last order for each node, as long as the process lives. Whoever may write in the
/// registry can write an order there again that a master signed long ago; before a master changes an order and signs
/// the result, it compares the order's time with the time remembered here. Thread safe.
class LastGiven {
 public:
  /// To be called when this master has written an order for the node, or its removal.
  void note(const std::string& path, std::int64_t given_ms) IOTCLOUD_EXCLUDES(mutex_);
  /// When this master wrote its last order for the node. 0: it wrote none, or that was many orders ago.
  std::int64_t at(const std::string& path) const IOTCLOUD_EXCLUDES(mutex_);
  /// Forgets the nodes below this one, because a person has said that they are meant as they stand.
  void forget(const std::string& above) IOTCLOUD_EXCLUDES(mutex_);

 private:
  static constexpr std::size_t many = 100'000;
  using Times = std::map<std::string, std::int64_t>;
  mutable config::Mutex mutex_;
  Times newer_ IOTCLOUD_GUARDED_BY(mutex_), older_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// The orders of instances as they stand in the registry. Thread safe; \throws discovery::RegistryError.
class OrderBook {
 public:
  using Seal = std::function<std::string(const std::string& path, const std::string& bytes)>;
  using IsSealed = std::function<bool(const std::string& path, const std::string& bytes)>;
  /// The references outlive this. \param seal MasterOptions::seal \param is_sealed MasterOptions::is_sealed
  OrderBook(discovery::Registry& registry, const discovery::Paths& paths, const Leadership& leadership,
            const Seal& seal, const IsSealed& is_sealed)
      : registry_(registry), paths_(paths), leadership_(leadership), seal_(seal), is_sealed_(is_sealed) {}

  /// Finds the instances that have an order on a gateway in `known`, or else a record. An instance is where its order
  /// stands, because only masters write orders; whoever may write one gateway's records may make one with any
  /// instance's id. Records that cannot be read are passed over. Takes the same few rounds of reads however many
  /// instances there are.
  std::map<discovery::InstanceId, LocatedInstance> locate(const std::set<discovery::InstanceId>& instances,
                                                          const std::vector<discovery::GatewayStatus>& known);

  /// Finds all selected instances. Called before the first order is written, so that a mistyped id changes nothing.
  /// \return a refusal; nullopt: all were found and are in `instances`.
  std::optional<OrderResult> find_selected(const InstanceSelection& selection,
                                           const std::vector<discovery::GatewayStatus>& known,
                                           std::vector<LocatedInstance>& instances);

  /// What the record says that was found; nullopt: there is none.
  std::optional<discovery::DriverRecord> record_of(const LocatedInstance& where) const;
  /// The instance's present order; nullopt: there is none.
  std::optional<discovery::OrderRecord> get(const discovery::GatewayId& gateway, const discovery::InstanceId& instance);
  void create(const discovery::GatewayId& gateway, discovery::OrderRecord order, const discovery::Lead& lead);
  EarlyOutcome remove(const LocatedInstance& where, const discovery::Lead& lead);
  /// Whether to sign what is left of an order after a change, if no trusted master signed the order: only when nothing
  /// of it is left.
  enum class Standing { is_kept, is_replaced };
  /// Changes an existing order. Reads it and changes it again when another write came in between. What a rule of a
  /// gateway makes has no order.
  EarlyOutcome rewrite(const LocatedInstance& where, const discovery::Lead& lead,
                       const std::function<void(discovery::OrderRecord&)>& alter,
                       Standing standing = Standing::is_kept);
  /// Whether a rule of its gateway makes the instance, and no master has ordered it.
  bool is_made_by_rule(const LocatedInstance& where);
  /// As rewrite(), of what people say about an instance that a rule makes (discovery::OrderRecord::made_by); makes the
  /// word if there is none. `alter` may make an order of it.
  EarlyOutcome rewrite_word(const LocatedInstance& where, const discovery::Lead& lead,
                            const std::function<void(discovery::OrderRecord&)>& alter);
  /// The bytes for the node at that path, signed if this master signs.
  std::string sealed(const std::string& path, const std::string& bytes) const {
    return seal_ ? seal_(path, bytes) : bytes;
  }
  bool seals() const { return static_cast<bool>(seal_); }
  /// Whether this master may sign what it makes of these bytes.
  bool is_ours(const std::string& path, const std::string& bytes) const {
    return !is_sealed_ || is_sealed_(path, bytes);
  }
  /// Whether a signed order is not the last that was given for its node: this master has written a later one, or the
  /// node was written long after a master gave what stands there. \param known last_given() before the node was read
  bool is_old(const discovery::Node& node, std::int64_t given_ms, std::int64_t known) const;
  std::int64_t last_given(const std::string& path) const { return given_.at(path); }
  /// Writes a topology's order. \param node what stood there when the order was made; nullopt: nothing
  void put_topology(const std::string& path, const std::optional<discovery::Node>& node,
                    const discovery::TopologyOrder& order, const discovery::Lead& lead);
  /// Writes what is submitted for a topology. \param node what stood there when it was made; nullopt: nothing
  void put_submission(const std::string& path, const std::optional<discovery::Node>& node,
                      const discovery::Submission& submission, const discovery::Lead& lead);
  void forget_given(const discovery::GatewayId& gateway) { given_.forget(paths_.orders(gateway)); }

 private:
  std::map<discovery::InstanceId, discovery::GatewayId> ordered_on(const std::set<discovery::InstanceId>& instances,
                                                                   const std::vector<discovery::GatewayStatus>& known);
  discovery::GatewayId true_place(const discovery::InstanceId& instance,
                                  const std::vector<discovery::GatewayId>& gateways);
  void put_signed(const std::string& path, const std::optional<discovery::Node>& node, const std::string& order,
                  std::int64_t given_ms, const discovery::Lead& lead);
  /// A master that does not sign asks nobody when an order was given, and remembers nothing.
  void note_given(const std::string& path, std::int64_t given_ms) {
    if (seals()) given_.note(path, given_ms);
  }
  std::optional<discovery::OrderRecord> first_word(const LocatedInstance& where) const;
  EarlyOutcome rewrite_standing(const LocatedInstance& where, const discovery::Lead& lead,
                                const std::function<EarlyOutcome(discovery::OrderRecord&)>& alter, Standing standing);
  void announce_removal(const LocatedInstance& where, const discovery::OrderRecord* order, const discovery::Lead& lead);
  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Leadership& leadership_;
  const Seal& seal_;
  const IsSealed& is_sealed_;
  LastGiven given_;
};

/// ZooKeeper refuses nodes above 1 MiB; an order near that is a mistake.
inline constexpr std::size_t largest_order = std::size_t{512} * 1024;

}  // namespace iotcloud::master
