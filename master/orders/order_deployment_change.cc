#include <fmt/format.h>

#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::OrderRecord;

OrderResult Master::change_deployment(const DeploymentChange& change) {
  return impl_->guarded([&] { return impl_->change_deployment(change); });
}

OrderResult Master::Impl::change_deployment(const DeploymentChange& change) {
  if (!change.properties && !change.manager) return refuse(Refusal::bad_request, "nothing is to change");
  if (change.manager && !change.manager->empty() && !is_node_name(*change.manager))
    return refuse(
        Refusal::bad_request,
        fmt::format("\"{}\" cannot be the name of a manifest: no '/' and no control characters", *change.manager));
  const auto known = discovery::list_gateways(registry, options.paths);
  std::vector<Located> instances;
  if (auto refusal = find_selected({change.instances, {}, change.wait}, known, instances)) return *refusal;
  OrderResult result;
  OutcomeWatch watch(registry, options.paths, OutcomeWatch::Wanted::anew);
  for (const auto& where : instances) {
    InstanceOutcome outcome{where.gateway, where.instance, Outcome::unknown, ""};
    set_verdict(outcome, order_deployment_change(where, find(known, where.gateway), change, watch));
    result.outcomes.push_back(std::move(outcome));
  }
  DirectCalls none;
  settle(result, watch, none, change.wait, "change");
  return result;
}

Master::Impl::MaybeVerdict Master::Impl::order_deployment_change(const Located& where, const GatewayStatus* gateway,
                                                                 const DeploymentChange& change, OutcomeWatch& watch) {
  const auto failed = [](const char* why) { return OutcomeWatch::Verdict{Outcome::failed, why}; };
  if (gateway == nullptr) return failed("its gateway is not registered any more");
  if (is_direct(where.gateway)) return failed("its gateway is of the original system: deploy it again");
  if (!gateway->alive && !options.record_for_lost_gateways) return failed(lost_and_not_recorded_text);
  return written([&](const discovery::Lead& lead) -> MaybeVerdict {
    bool made_anew = false;
    const auto verdict = rewrite_order(where, lead, [&](OrderRecord& order) {
      made_anew = change.properties && *change.properties != order.properties;
      if (change.properties) order.properties = *change.properties;
      if (change.manager) order.manager = *change.manager;
    });
    if (verdict) return verdict;
    if (!made_anew) return OutcomeWatch::Verdict{Outcome::done, ""};
    if (!gateway->alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

}  // namespace iotcloud::master
