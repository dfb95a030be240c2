#include <algorithm>
#include <tuple>

#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/master/orders/draining.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::DriverState;
using discovery::GatewayStatus;
using discovery::OrderRecord;

OrderResult Draining::drain(const GatewaySelection& selection, bool undo) {
  return desk_.leadership.guarded([&] { return drain_all(selection, undo); });
}

OrderResult Draining::drain_all(const GatewaySelection& selection, bool undo) {
  if (selection.gateways.empty()) return refuse(OrderRefusal::bad_request, "no gateway is named: give at least one id");
  const auto lead = desk_.leadership.lead();
  if (!lead) return refuse(OrderRefusal::not_leading, lost_lead_text);
  const auto known = desk_.gateways();
  for (const auto& id : selection.gateways) {
    if (!find(known, id)) return refuse_gateway(id, known);
    if (desk_.is_direct(id))
      return refuse(OrderRefusal::bad_request,
                    fmt::format("gateway {0} is of the original system, which cannot drain; `iotcloud stop --all "
                                "--gateway {0}` stops what it has",
                                id));
  }
  {
    // A deployment either has written its orders before this lock, or sees the marks after it.
    const config::WriteLock lock(desk_.placing);
    for (const auto& id : selection.gateways) mark(id, undo, *lead);
  }
  const std::set<discovery::GatewayId> ids(selection.gateways.begin(), selection.gateways.end());
  auto orders = discovery::list_orders(desk_.registry, desk_.options.paths, {ids.begin(), ids.end()},
                                       discovery::Unreadable::throws);
  std::set<discovery::InstanceId> ordered;
  for (const auto& placed : orders) ordered.insert(placed.order.instance);
  std::erase_if(orders, [&](const auto& placed) { return undo ? !placed.order.drained : !placed.order.active; });
  if (!undo) add_made_by_rules(ids, ordered, orders);
  std::sort(orders.begin(), orders.end(), [](const auto& a, const auto& b) {
    return std::tie(a.gateway, a.order.name, a.order.index, a.order.instance) <
           std::tie(b.gateway, b.order.name, b.order.index, b.order.instance);
  });
  std::set<discovery::InstanceId> instances;
  for (const auto& placed : orders) instances.insert(placed.order.instance);
  auto drained_gateways = known;
  std::erase_if(drained_gateways, [&](const auto& gateway) { return !ids.contains(gateway.record.id); });
  const auto located = desk_.book.locate(instances, drained_gateways);

  OrderResult result;
  OutcomeWatch watch(desk_.registry, desk_.options.paths,
                     undo ? OutcomeWatch::Wanted::active : OutcomeWatch::Wanted::inactive);
  std::vector<LocatedInstance> drained;
  for (const auto& [gateway, order] : orders) {
    const auto found = located.find(order.instance);
    const bool is_here = found != located.end() && found->second.gateway == gateway;
    drained.push_back(is_here ? found->second : LocatedInstance{order.instance, gateway, {}, std::nullopt});
  }
  desk_.order_each(drained, result, [&](const LocatedInstance& where) {
    return this->order(where, *find(known, where.gateway), undo, watch);
  });
  desk_.settle(result, watch, selection.wait, undo ? "undrain" : "drain");
  return result;
}

/// What rules of the gateways have made has no order as long as nobody said anything about it.
void Draining::add_made_by_rules(const std::set<discovery::GatewayId>& gateways,
                                 const std::set<discovery::InstanceId>& ordered,
                                 std::vector<discovery::PlacedOrder>& orders) {
  for (const auto& record : discovery::list_drivers(desk_.registry, desk_.options.paths)) {
    if (record.made_by.empty() || ordered.contains(record.instance) || !gateways.contains(record.gateway)) continue;
    OrderRecord order;
    order.instance = record.instance;
    order.name = record.deployment;
    order.index = record.index;
    orders.push_back({record.gateway, std::move(order)});
  }
}

void Draining::mark(const discovery::GatewayId& gateway, bool undo, const discovery::Lead& lead) {
  const auto path = desk_.options.paths.gateway_draining(gateway);
  const auto node = desk_.registry.get(path);
  if (node && discovery::decode_drain(node->data, path).epoch > lead.epoch)
    throw config::Error("a later master has given orders for it; this one's lead is over");
  if (undo) {
    desk_.registry.remove(path, -1, lead.fence);
  } else if (!node) {
    discovery::DrainRecord mark;
    mark.since_ms = config::system_clock().wall_ms();
    mark.epoch = lead.epoch;
    desk_.registry.create(path, encode(mark), true, lead.fence);
  }
}

EarlyOutcome Draining::order(const LocatedInstance& where, const GatewayStatus& gateway, bool undo,
                             OutcomeWatch& watch) {
  return desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
    const auto alter = [&](OrderRecord& order) {
      const bool concerned = undo ? order.drained : order.active;
      order.active = undo ? order.active || concerned : false;
      order.drained = !undo && (order.drained || concerned);
    };
    const auto early = desk_.book.is_made_by_rule(where) ? desk_.book.rewrite_word(where, lead, alter)
                                                         : desk_.book.rewrite(where, lead, alter);
    if (early) return early;
    if (auto postponed = waiting(gateway)) return postponed;
    const auto record = desk_.book.record_of(where);
    if (record && record->state == DriverState::failed && !undo)
      return ReasonedOutcome{OrderOutcome::done, "it had failed before"};
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

std::vector<OrderKind> draining_orders() {
  const auto drain = [](bool undo) {
    return [undo](auto& services, const auto& order) { return services.draining.drain(order, undo); };
  };
  return {order_kind<GatewaySelection>("drain", security::Role::operating, drain(false)),
          order_kind<GatewaySelection>("undrain", security::Role::operating, drain(true))};
}

}  // namespace iotcloud::master
