#include <algorithm>
#include <chrono>
#include <tuple>

#include <fmt/format.h>

#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::DriverState;
using discovery::GatewayStatus;
using discovery::OrderRecord;
using discovery::RegistryError;
using discovery::RegistryErrorCode;

namespace {

std::int64_t wall_ms() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(system_clock::now().time_since_epoch()).count();
}

}  // namespace

OrderResult Master::drain(const GatewaySelection& selection) {
  return impl_->guarded([&] { return impl_->drain(selection, false); });
}

OrderResult Master::undrain(const GatewaySelection& selection) {
  return impl_->guarded([&] { return impl_->drain(selection, true); });
}

OrderResult Master::Impl::drain(const GatewaySelection& selection, bool undo) {
  if (selection.gateways.empty()) return refuse(Refusal::bad_request, "no gateway is named: give at least one id");
  const auto lead = election.lead();
  if (!lead) return refuse(Refusal::not_leading, lost_lead_text);
  const auto known = discovery::list_gateways(registry, options.paths);
  for (const auto& id : selection.gateways) {
    if (!find(known, id)) return refuse_gateway(id, known);
    if (is_direct(id))
      return refuse(Refusal::bad_request,
                    fmt::format("gateway {0} is of the original system, which cannot drain; `iotcloud stop --all "
                                "--gateway {0}` stops what it has",
                                id));
  }
  {
    const std::unique_lock lock(placing);  // every deployment has written its orders, or will see the marks
    for (const auto& id : selection.gateways) mark_draining(id, undo, *lead);
  }
  const std::set<std::string> ids(selection.gateways.begin(), selection.gateways.end());
  auto orders = discovery::list_orders(registry, options.paths, {ids.begin(), ids.end()});
  std::erase_if(orders, [&](const auto& placed) { return undo ? !placed.order.drained : !placed.order.active; });
  std::sort(orders.begin(), orders.end(), [](const auto& a, const auto& b) {
    return std::tie(a.gateway, a.order.name, a.order.index, a.order.instance) <
           std::tie(b.gateway, b.order.name, b.order.index, b.order.instance);
  });
  std::set<std::string> instances;
  for (const auto& placed : orders) instances.insert(placed.order.instance);
  const auto located = locate(instances, {});

  OrderResult result;
  OutcomeWatch watch(registry, options.paths, undo ? OutcomeWatch::Wanted::active : OutcomeWatch::Wanted::inactive);
  for (const auto& [gateway, order] : orders) {
    const auto found = located.find(order.instance);
    const Located where = found == located.end() ? Located{order.instance, gateway, "", std::nullopt} : found->second;
    InstanceOutcome outcome{gateway, order.instance, Outcome::unknown, ""};
    set_verdict(outcome, order_drain(where, *find(known, gateway), undo, watch));
    result.outcomes.push_back(std::move(outcome));
  }
  DirectCalls none;
  settle(result, watch, none, selection.wait, undo ? "undrain" : "drain");
  return result;
}

void Master::Impl::mark_draining(const std::string& gateway, bool undo, const discovery::Lead& lead) {
  const auto path = options.paths.gateway_draining(gateway);
  const auto node = registry.get(path);
  if (node && discovery::decode_drain(node->data, path).epoch > lead.epoch)
    throw config::Error("a later master has given orders for it; this one's lead is over");
  if (undo) {
    registry.remove(path, -1, lead.fence);
  } else if (!node) {
    discovery::DrainRecord mark;
    mark.since_ms = wall_ms();
    mark.epoch = lead.epoch;
    registry.create(path, encode(mark), true, lead.fence);
  }
}

Master::Impl::MaybeVerdict Master::Impl::order_drain(const Located& where, const GatewayStatus& gateway, bool undo,
                                                     OutcomeWatch& watch) {
  return written([&](const discovery::Lead& lead) -> MaybeVerdict {
    const auto verdict = rewrite_order(where, lead, [&](OrderRecord& order) {
      const bool concerned = undo ? order.drained : order.active;
      order.active = undo ? order.active || concerned : false;
      order.drained = !undo && (order.drained || concerned);
    });
    if (verdict) return verdict;
    if (!gateway.alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    const bool had_failed =
        where.record && discovery::decode_driver(where.record->data, where.instance).state == DriverState::failed;
    if (had_failed && !undo) return OutcomeWatch::Verdict{Outcome::done, "it had failed before"};
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

}  // namespace iotcloud::master
