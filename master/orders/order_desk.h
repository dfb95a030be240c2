#pragma once

#include <chrono>
#include <future>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/master/listing/driver_view.h>
#include <iotcloud/master/master_options.h>
#include <iotcloud/master/orders/order_book.h>
#include <iotcloud/master/orders/outcome_watch.h>

namespace iotcloud::master {

inline constexpr const char* lost_text = "gateway is lost; it will follow the order when it comes back";
inline constexpr const char* frozen_text = "gateway is frozen; it follows the order after `iotcloud registry adopt`";
inline constexpr const char* lost_and_not_recorded_text = "gateway is lost; the order was not recorded";

/// What the services that take orders (deployments.h, instance_changes.h, draining.h, updates.h, topology_service.h)
/// share. The desk outlives the services. Thread safe.
struct OrderDesk {
  OrderDesk(discovery::Registry& registry_of_all, MasterOptions given);

  using DirectCalls = std::vector<std::future<InstanceOutcome>>;

  std::vector<discovery::GatewayStatus> gateways() { return discovery::list_gateways(registry, options.paths); }
  /// Whether the gateway is of the original system.
  bool is_direct(const discovery::GatewayId& gateway) const;
  /// Why the order of an instance on that gateway cannot be rewritten; nullopt: it can. \param direct_text the reason
  /// for a gateway of the original system.
  EarlyOutcome obstacle(const LocatedInstance& where, const discovery::GatewayStatus* gateway,
                        const char* direct_text) const;
  /// How long to wait for outcomes when the request says `wait`.
  std::chrono::milliseconds limit(const WaitLimit& wait) const;
  /// Waits for all outcomes, then logs and counts them.
  void settle(OrderResult& result, OutcomeWatch& watch, const WaitLimit& wait, const std::string& order,
              DirectCalls calls = {});
  /// Logs and counts what became of an order.
  void tell(const OrderResult& result, const std::string& order);
  /// Gives an order to each instance. \param give takes a LocatedInstance, gives the order, and returns its outcome if
  /// that is known already.
  template <typename Give>
  static void order_each(const std::vector<LocatedInstance>& instances, OrderResult& result, Give&& give) {
    for (const auto& where : instances) {
      auto& outcome =
          result.outcomes.emplace_back(InstanceOutcome{where.gateway, where.instance, OrderOutcome::unknown, ""});
      set_outcome(outcome, give(where));
    }
  }
  static void set_outcome(InstanceOutcome& outcome, const EarlyOutcome& early);

  discovery::Registry& registry;
  const MasterOptions options;
  DriverView view{registry, options.paths};
  /// Locked shared while orders that make instances run are written, exclusively while gateways are marked as draining.
  /// So either the drain sees the orders, or the orders see the mark.
  config::SharedMutex placing;
  const discovery::GuardPtr branches = discovery::keep_branches(registry, options.paths);
  Leadership leadership;
  OrderBook book{registry, options.paths, leadership, options.seal, options.is_sealed};
};

/// The outcome of an order that the gateway follows later; nullopt: it follows orders now.
inline EarlyOutcome waiting(const discovery::GatewayStatus& gateway) {
  if (!gateway.alive) return ReasonedOutcome{OrderOutcome::pending, lost_text};
  if (!gateway.frozen.empty()) return ReasonedOutcome{OrderOutcome::pending, frozen_text};
  return std::nullopt;
}

/// Refuses a plugin's name or hash that is not valid; nullopt: both are.
std::optional<OrderResult> refuse_plugin(const std::string& plugin, const std::string& sha256);

}  // namespace iotcloud::master
