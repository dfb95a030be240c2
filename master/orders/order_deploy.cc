#include <set>

#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::OrderRecord;

OrderResult Master::deploy(const DeployRequest& request) {
  return impl_->guarded([&] { return impl_->deploy(request); });
}

std::optional<OrderResult> Master::Impl::refuse_deployment(const DeployRequest& request) const {
  if (!is_node_name(request.plugin))
    return refuse(Refusal::bad_request,
                  fmt::format("\"{}\" is no plugin: give the name of a file in the gateway's plugin folder, "
                              "such as turtle.so, without its path",
                              request.plugin));
  if (!request.driver.empty() && !is_node_name(request.driver))
    return refuse(Refusal::bad_request,
                  fmt::format("\"{}\" cannot be a driver's name: no '/' and no control characters", request.driver));
  if (request.count < 1 || request.count > DeployRequest::max_count)
    return refuse(Refusal::bad_request,
                  fmt::format("count is {}, must be from 1 to {}", request.count, DeployRequest::max_count));
  const auto size = encode(order_for(request)).size();
  if (size > largest_order)
    return refuse(Refusal::bad_request, fmt::format("properties and metadata take {} bytes, more than {}: pass large "
                                                    "things by the name of a file on the gateway",
                                                    size, largest_order));
  return std::nullopt;
}

OrderRecord Master::Impl::order_for(const DeployRequest& request) const {
  OrderRecord order;
  order.driver = request.driver;
  order.plugin = request.plugin;
  order.properties = request.properties;
  order.metadata = request.metadata;
  order.epoch = leading_epoch();
  return order;
}

OrderResult Master::Impl::deploy(const DeployRequest& request) {
  if (auto refusal = refuse_deployment(request)) return *refusal;
  const auto known = discovery::list_gateways(registry, options.paths);
  std::vector<const GatewayStatus*> targets;
  std::set<std::string> seen;
  for (const auto& id : request.gateways) {
    const auto* gateway = find(known, id);
    if (!gateway) return refuse_gateway(id, known);
    if (seen.insert(id).second) targets.push_back(gateway);
  }
  if (request.gateways.empty())
    for (const auto& gateway : known) targets.push_back(&gateway);
  if (targets.empty()) return refuse_gateway("", known);

  OrderResult result;
  OutcomeWatch watch(registry, options.paths, OutcomeWatch::Wanted::active);
  DirectCalls calls;
  auto order = order_for(request);
  for (const auto* gateway : targets) {
    const auto& id = gateway->record.id;
    for (int i = 0; i < request.count; ++i) {
      if (is_direct(id) && gateway->alive) {
        calls.push_back(std::async(std::launch::async, [this, id, &request] {
          return options.direct->deploy(id, request, limit(request.wait));
        }));
        continue;
      }
      order.instance = discovery::new_instance_id();
      InstanceOutcome outcome{id, order.instance, Outcome::unknown, ""};
      set_verdict(outcome, order_deployment(*gateway, order, watch));
      result.outcomes.push_back(std::move(outcome));
    }
  }
  settle(result, watch, calls, request.wait, "deploy");
  return result;
}

Master::Impl::MaybeVerdict Master::Impl::order_deployment(const GatewayStatus& gateway, const OrderRecord& order,
                                                          OutcomeWatch& watch) {
  if (!gateway.alive && (!options.record_for_lost_gateways || is_direct(gateway.record.id)))
    return OutcomeWatch::Verdict{Outcome::failed, lost_and_not_recorded_text};
  return written([&]() -> MaybeVerdict {
    const auto path = options.paths.order(gateway.record.id, order.instance);
    registry.create(path, encode(order));
    if (leading_epoch() != order.epoch) {
      // A master that was frozen, say, wrote it when another one led already. Gateways that know the other one ignore
      // it, and none is to find it later.
      registry.remove(path);
      return OutcomeWatch::Verdict{Outcome::failed, "this master's lead ended meanwhile; the order was taken back"};
    }
    if (!gateway.alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    watch.expect(order.instance, order.driver, std::nullopt);
    return std::nullopt;
  });
}

}  // namespace iotcloud::master
