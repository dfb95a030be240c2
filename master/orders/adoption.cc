#include <algorithm>
#include <map>

#include <fmt/format.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/master/orders/adoption.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::GatewayId;

namespace {

/// Watches the marks of frozen gateways until they are gone.
class ThawWatch {
 public:
  explicit ThawWatch(discovery::Registry& registry) : registry_(registry) {}
  ~ThawWatch() { guards_.clear(); }  // waits for the callbacks, which use the other members
  ThawWatch(const ThawWatch&) = delete;
  ThawWatch& operator=(const ThawWatch&) = delete;

  void expect(const GatewayId& gateway, const std::string& mark) {
    {
      const config::MutexLock lock(mutex_);
      frozen_.insert(gateway);
    }
    guards_.push_back(registry_.watch_node(mark, [this, gateway](const std::optional<discovery::Node>& node) {
      if (node) return;
      const config::MutexLock lock(mutex_);
      frozen_.erase(gateway);
      changed_.notify_all();
    }));
  }
  /// \return those that are still frozen.
  std::set<GatewayId> wait(std::chrono::milliseconds limit, const std::stop_token& stop) {
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, stop, limit, [this]() IOTCLOUD_REQUIRES(mutex_) { return frozen_.empty(); });
    return frozen_;
  }

 private:
  discovery::Registry& registry_;
  config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::set<GatewayId> frozen_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<discovery::GuardPtr> guards_;
};

}  // namespace

OrderResult Adoptions::adopt(const GatewaySelection& selection) {
  return desk_.leadership.guarded([&] { return adopt_all(selection); });
}

OrderResult Adoptions::adopt_all(const GatewaySelection& selection) {
  const auto known = desk_.gateways();
  auto chosen = selection.gateways;
  if (chosen.empty()) {
    for (const auto& gateway : known) {
      if (!gateway.frozen.empty()) chosen.push_back(gateway.record.id);
    }
  }
  for (const auto& id : chosen) {
    if (!find(known, id)) return refuse_gateway(id, known);
  }
  OrderResult result;
  ThawWatch watch(desk_.registry);
  for (const auto& id : chosen) {
    auto& outcome = result.outcomes.emplace_back(InstanceOutcome{id, {}, OrderOutcome::unknown, ""});
    const std::string mark = discovery::freeze_path(desk_.options.paths, id);
    OrderDesk::set_outcome(outcome, desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
      desk_.book.forget_given(id);  // also where another master has thawed it: this one may have led before
      const auto node = desk_.registry.get(mark);
      if (!node) return ReasonedOutcome{OrderOutcome::done, "it was not frozen"};
      const discovery::Adoption adoption{discovery::decode_freeze(node->data, mark).token, lead.epoch};
      const auto orders = desk_.options.paths.orders(id);
      discovery::put(desk_.registry, orders, desk_.book.sealed(orders, encode(adoption)), lead.fence);
      if (!find(known, id)->alive) return ReasonedOutcome{OrderOutcome::pending, lost_text};
      watch.expect(id, mark);
      return std::nullopt;
    }));
  }
  const auto frozen = watch.wait(desk_.limit(selection.wait), desk_.leadership.closing());
  for (auto& outcome : result.outcomes) {
    if (outcome.outcome != OrderOutcome::unknown) continue;
    if (frozen.contains(outcome.gateway)) {
      outcome.reason = "it has not said yet that it follows the orders; it may still do so";
    } else {
      outcome.outcome = OrderOutcome::done;
    }
  }
  desk_.tell(result, "adopt");
  return result;
}

std::vector<OrderKind> adoption_orders() {
  return {order_kind<GatewaySelection>("adopt", security::Role::admin, [](auto& services, const auto& selection) {
    return services.adoptions.adopt(selection);
  })};
}

}  // namespace iotcloud::master
