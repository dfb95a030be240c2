#include <fmt/format.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/orders/forgetting.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::GatewayId;

namespace {

/// Removes all that the registry has of a gateway. Its own node goes last: until then the gateway can be named again
/// when this fails half-way.
ReasonedOutcome remove_gateway(discovery::Registry& registry, const discovery::Paths& paths, const GatewayId& id,
                               const discovery::Lead& lead) {
  std::size_t instances = 0;
  for (const auto& driver : discovery::list_drivers(registry, paths)) {
    if (driver.gateway != id) continue;
    discovery::remove_tree(registry, paths.instance(driver.name, driver.instance), lead.fence);
    ++instances;
  }
  const auto orders = discovery::list_orders(registry, paths, {id}).size();
  discovery::remove_tree(registry, paths.gateway(id), lead.fence);
  return {OrderOutcome::done,
          fmt::format("forgotten, with {} order(s) and the record(s) of {} instance(s)", orders, instances)};
}

}  // namespace

OrderResult Forgetting::forget(const GatewaySelection& selection) {
  return desk_.leadership.guarded([&] { return forget_all(selection); });
}

OrderResult Forgetting::forget_all(const GatewaySelection& selection) {
  if (selection.gateways.empty())
    return refuse(OrderRefusal::bad_request, "name the gateways that are to be forgotten");
  const auto known = desk_.gateways();
  for (const auto& id : selection.gateways) {
    if (!find(known, id)) return refuse_gateway(id, known);
  }
  OrderResult result;
  for (const auto& id : selection.gateways) {
    auto& outcome = result.outcomes.emplace_back(InstanceOutcome{id, {}, OrderOutcome::unknown, ""});
    OrderDesk::set_outcome(outcome, desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
      if (desk_.registry.get(desk_.options.paths.gateway_alive(id)))
        return ReasonedOutcome{OrderOutcome::failed,
                               "it is alive; undeploy what it runs, stop its process, and forget it then"};
      return remove_gateway(desk_.registry, desk_.options.paths, id, lead);
    }));
  }
  desk_.tell(result, "forget");
  return result;
}

std::vector<OrderKind> forgetting_orders() {
  return {order_kind<GatewaySelection>(
      "forgetGateway", security::Role::admin,
      [](auto& services, const auto& selection) { return services.forgetting.forget(selection); })};
}

}  // namespace iotcloud::master
