#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/followed_orders.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::gateway {

/// Follows the orders of one gateway in the registry (/iot/gateways/<id>/orders) and passes each version of an order to
/// the listener once. The feed ignores an order whose epoch is older than one seen before, because its master no longer
/// leads. Orders that exist when the feed starts, or when the registry is reachable again, may have any epoch. When the
/// master with the older epoch does lead, as the registry has it, the registry was put back to an earlier state.
///
/// Orders that are not there are an order to undeploy only while the registry is the one that had them. When the node
/// of the orders is gone or is another one than before, or when orders vanished together with what this gateway has
/// recorded of their instances, the registry was emptied or put back to an earlier state. Then the feed is frozen: the
/// listener hears of no order, and the node discovery::freeze_path() says why, also to the gateway's next run. The feed
/// goes on when a master adopts the registry as it is (discovery::Adoption), or when the orders' own node is back.
///
/// With the keys of masters the feed follows only what one of them has signed (security/signed_object.h) for the very
/// node in which it stands, and that was not given before the last one for its instance: an old one may have been
/// written again by somebody else. What was followed is on the disk before the listener hears of it (FollowedOrders),
/// so that this holds after a restart, too; orders that are older at the start, in nodes that are older or others, say
/// that the registry was put back, and freeze the feed. An order that is gone is one to undeploy only with a signed
/// discovery::OrderRemoval, or when a master adopts the registry. What is refused changes nothing of what runs: it is
/// logged, counted (iotcloud_gateway_orders_refused_total) and told by refused().
///
/// Used on one event loop, on which the listener is called, unless said otherwise.
class OrderFeed {
 public:
  using Instances = std::set<discovery::InstanceId>;
  struct Listener {
    /// The names of the orders that exist when the feed starts. Called once, before the next two.
    std::function<void(const Instances& names)> on_first;
    /// An order was given or changed; `version` is the node's.
    std::function<void(const discovery::OrderRecord& order, std::int64_t version)> on_order;
    /// The order was removed: it has been gone for `vanish_pause` and no other order went in that time, or it has been
    /// gone for `longest_vanish_pause`.
    std::function<void(const discovery::InstanceId& instance)> on_gone;
    /// The instances that the gateway has, ordered in this run or adopted from an earlier one.
    std::function<Instances()> present;
    /// Returns those of the given instances whose record this gateway has written and does not find in the registry.
    /// \throws discovery::RegistryError.
    std::function<Instances(const Instances& of)> without_record;
    /// The feed has just been frozen.
    std::function<void()> on_frozen;
    /// The orders have been read, and are followed or not: from now on the gateway may write its records.
    std::function<void()> on_orders_read;
    /// Writes into the audit log that signed orders, or removals of orders, are about to be followed. May be empty.
    /// \throws config::Error when they must not be followed, because that cannot be written
    std::function<void(const std::vector<security::AuditEntry>& orders)> audit_begun{};
    /// Takes a line for the audit log: a signed order, or removal of one, that was followed, or one that is refused.
    /// May be empty.
    std::function<void(security::AuditEntry entry)> audit{};
  };

  /// \param followed_file see FollowedOrders. \throws config::Error as FollowedOrders does.
  OrderFeed(discovery::Registry& registry, discovery::Paths paths, discovery::GatewayId gateway, EventLoop& loop,
            const config::Clock& clock, Listener listener,
            std::shared_ptr<const security::TrustedKeys> masters = nullptr, std::string followed_file = "");

  void start();
  /// Afterwards the listener is not called any more.
  void stop();
  /// Looks whether the registry still has this gateway's orders, and reads them; the listener's on_orders_read tells
  /// when that is done, which may be later, when the registry answers.
  void read_orders() { read_orders(Reading::all); }
  /// The highest epoch of the orders seen. Thread safe.
  std::int64_t epoch() const { return epoch_; }
  /// Why no orders are followed now; empty: they are followed. Thread safe.
  std::string frozen() const;
  /// Which order is refused, and why, in one line; empty: none is. Thread safe.
  std::string refused() const;

 private:
  /// Whether to read all orders, or only their names. When an order is gone only the names are read, so that the
  /// removal of one of thousands does not cost a read of all.
  enum class Reading { all, names };
  struct Found;
  struct Objection {
    std::string reason;
    bool lasting = false;  ///< see FreezeRecord
  };
  void read_orders(Reading reading);
  void read_when_answered();
  Found read_registry(Reading reading);
  bool nothing_to_lose() const;
  std::optional<Objection> objection(const Found& found) const;
  std::optional<discovery::InstanceId> put_back(const Found& found) const;
  std::optional<discovery::Adoption> adoption(const discovery::Node& list) const;
  void take_up_freeze(const discovery::Node& node);
  void freeze(const Objection& objection, const Found& found);
  void follow_all(const Found& found);
  bool thaw();
  Instances just_gone(const Instances& names);
  void read_again_soon();
  std::optional<discovery::FreezeRecord> freeze_record() const;
  void names_changed(const std::optional<std::vector<std::string>>& names);
  void follow_names(const Instances& names);
  void order_changed(const discovery::InstanceId& instance, const std::optional<discovery::Node>& node);
  void take(const discovery::InstanceId& instance, const discovery::Node& node);
  void read(const discovery::InstanceId& instance, const discovery::Node& node);
  std::optional<std::string> signer_of(const std::string& path, const discovery::Node& node) const;
  bool is_out_of_date(const discovery::OrderRecord& order) const;
  bool leads_now(std::int64_t epoch) const;
  struct Followed;
  void write_down(const std::vector<Followed>& orders);
  void audit_followed(const std::vector<Followed>& orders);
  FollowedOrder followed(const discovery::InstanceId& instance, std::int64_t given_ms) const;
  void follow_due();
  void read_refused_later();
  void read_refused_again();
  Instances without_removal(const Instances& names);
  struct Removal {
    std::int64_t given_ms = 0;
    std::string signer;
  };
  std::optional<Removal> removal_of(const discovery::InstanceId& instance,
                                    const std::optional<discovery::Node>& node) const;
  void watch_removal(const discovery::InstanceId& instance);
  void clear_removals(const Instances& gone);
  void refuse(const discovery::InstanceId& instance, const std::string& path, const std::string& what,
              const std::string& advice);
  void forget_refusal(const discovery::InstanceId& instance);
  bool is_handled(const discovery::InstanceId& instance, const discovery::Node& node) const;

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const discovery::GatewayId gateway_;
  EventLoop& loop_;
  const config::Clock& clock_;
  const Listener listener_;
  const std::shared_ptr<const security::TrustedKeys> masters_;  ///< null: orders need no signature
  std::atomic<std::int64_t> epoch_{0};
  /// Orders that existed at the start or after a reconnection and are not followed yet: they may have any epoch.
  Instances initial_;
  FollowedOrders done_;  ///< with the keys of masters: what was followed
  /// With the keys of masters: an order that is followed when it stands in done_.
  struct Due {
    discovery::OrderRecord order;
    std::int64_t created = 0;  ///< of its node
    std::int64_t version = 0;  ///< of its node
    std::string signer;
  };
  std::map<discovery::InstanceId, Due> due_;
  /// Of what is followed as soon as it can be written down: by the path of each, the time of the order of which the
  /// audit log says already that it is about to be followed.
  std::map<std::string, std::int64_t> begun_;
  Instances first_;              ///< orders that stood there at the start or at an adoption, and are not read yet
  std::int64_t started_ms_ = 0;  ///< wall time
  /// Orders that are gone, and no master says that it removed them: tells when one does.
  std::map<discovery::InstanceId, discovery::GuardPtr> unproven_;
  std::map<discovery::InstanceId, std::pair<std::int64_t, std::int64_t>>
      handled_;  ///< for each order that was read, the creation id and version of its node
  /// The same of orders that could not be judged, because the registry did not say who leads.
  std::map<discovery::InstanceId, std::pair<std::int64_t, std::int64_t>> unjudged_;
  std::optional<discovery::InstanceId> of_older_lead_;  ///< whose order says that the registry was put back
  std::optional<std::int64_t> followed_;  ///< creation id of the node whose orders are followed; nullopt: none yet
  std::map<discovery::InstanceId, config::Clock::Instant> gone_;  ///< the orders that are just_gone(), and since when
  config::Clock::Instant last_gone_{};                            ///< when the last one of them went
  bool reads_again_ = false;                                      ///< a timer is set
  bool reads_refused_ = false;                                    ///< a timer is set
  bool told_first_ = false;
  bool stopped_ = false;
  bool retrying_ = false;
  std::map<discovery::InstanceId, discovery::GuardPtr> order_watches_;
  discovery::GuardPtr names_watch_, node_watch_, session_listener_;

  mutable config::Mutex mutex_;
  std::optional<discovery::FreezeRecord> freeze_ IOTCLOUD_GUARDED_BY(mutex_);         ///< written only on the loop
  std::map<discovery::InstanceId, std::string> refused_ IOTCLOUD_GUARDED_BY(mutex_);  ///< what; written on the loop
  std::jthread keys_watch_;  ///< TrustedKeys::on_change(); last, because it uses the other members
};

}  // namespace iotcloud::gateway
