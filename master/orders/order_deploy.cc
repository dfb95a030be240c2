#include <set>

#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/master/orders/instance_id.h>
#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::OrderRecord;

OrderResult Master::deploy(const DeployRequest& request) {
  return impl_->guarded([&] { return impl_->deploy(request); });
}

std::optional<OrderResult> refuse_plugin(const std::string& plugin, const std::string& sha256) {
  if (!is_node_name(plugin))
    return refuse(Refusal::bad_request,
                  fmt::format("\"{}\" is no plugin: give the name of a file in the gateway's plugin folder, "
                              "such as turtle.so, without its path",
                              plugin));
  if (!sha256.empty() && !config::is_sha256(sha256))
    return refuse(Refusal::bad_request, fmt::format("{}: a SHA-256 has 64 hexadecimal digits in lower case", plugin));
  return std::nullopt;
}

std::optional<OrderResult> Master::Impl::refuse_deployment(const DeployRequest& request) const {
  if (auto refusal = refuse_plugin(request.plugin, request.sha256)) return refusal;
  if (!request.driver.empty() && !is_node_name(request.driver))
    return refuse(Refusal::bad_request,
                  fmt::format("\"{}\" cannot be a driver's name: no '/' and no control characters", request.driver));
  if (request.count < 1 || request.count > DeployRequest::max_count)
    return refuse(Refusal::bad_request,
                  fmt::format("count is {}, must be from 1 to {}", request.count, DeployRequest::max_count));
  if (request.name.empty() && (!request.indexes.empty() || !request.manager.empty()))
    return refuse(Refusal::bad_request, "numbers of instances, and a manifest that they belong to, need a name");
  for (const auto& [what, text] :
       {std::pair("a deployment", &request.name), std::pair("a manifest", &request.manager)}) {
    if (!text->empty() && !is_node_name(*text))
      return refuse(Refusal::bad_request,
                    fmt::format("\"{}\" cannot be the name of {}: no '/' and no control characters", *text, what));
  }
  for (const int index : request.indexes) {
    if (index < 1 || index > DeployRequest::max_count)
      return refuse(Refusal::bad_request,
                    fmt::format("an instance's number is {}, must be from 1 to {}", index, DeployRequest::max_count));
  }
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
  order.sha256 = request.sha256;
  order.properties = request.properties;
  order.metadata = request.metadata;
  order.active = request.active;
  order.name = request.name;
  order.manager = request.manager;
  return order;
}

std::optional<OrderResult> Master::Impl::find_targets(const DeployRequest& request,
                                                      const std::vector<GatewayStatus>& known,
                                                      std::vector<const GatewayStatus*>& targets) const {
  std::set<std::string> seen;
  for (const auto& id : request.gateways) {
    const auto* gateway = find(known, id);
    if (!gateway) return refuse_gateway(id, known);
    if (gateway->draining)
      return refuse(Refusal::bad_request,
                    fmt::format("gateway {0} is draining, so nothing is deployed on it; `iotcloud undrain {0}` ends "
                                "that",
                                id));
    if (seen.insert(id).second) targets.push_back(gateway);
  }
  if (!request.gateways.empty()) return std::nullopt;
  for (const auto& gateway : known) {
    if (!gateway.draining) targets.push_back(&gateway);
  }
  if (known.empty()) return refuse_gateway("", known);
  if (targets.empty())
    return refuse(Refusal::bad_request, "all gateways are draining; `iotcloud undrain GATEWAY` ends that");
  return std::nullopt;
}

OrderResult Master::Impl::deploy(const DeployRequest& request) {
  if (auto refusal = refuse_deployment(request)) return *refusal;
  OrderResult result;
  OutcomeWatch watch(registry, options.paths,
                     request.active ? OutcomeWatch::Wanted::active : OutcomeWatch::Wanted::inactive);
  DirectCalls calls;
  {
    const std::shared_lock lock(placing);
    const auto known = discovery::list_gateways(registry, options.paths);
    std::vector<const GatewayStatus*> targets;
    if (auto refusal = find_targets(request, known, targets)) return *refusal;
    for (const auto* gateway : targets) {
      const auto& id = gateway->record.id;
      if (is_direct(id) && !request.sha256.empty()) {
        result.outcomes.push_back(
            {id, "", Outcome::failed, "its gateway is of the original system, which takes no plugin file"});
      } else if (!is_direct(id) || !gateway->alive) {
        order_instances(request, *gateway, result, watch);
      } else if (!request.name.empty()) {
        result.outcomes.push_back({id, "", Outcome::failed,
                                   "its gateway is of the original system, which knows no names: deploy without one"});
      } else {
        for (int i = 0; i < request.count; ++i)
          calls.push_back(std::async(std::launch::async, [this, id, &request] {
            return options.direct->deploy(id, request, limit(request.wait));
          }));
      }
    }
  }
  settle(result, watch, calls, request.wait, "deploy");
  return result;
}

void Master::Impl::order_instances(const DeployRequest& request, const GatewayStatus& gateway, OrderResult& result,
                                   OutcomeWatch& watch) {
  const auto& id = gateway.record.id;
  auto order = order_for(request);
  if (request.name.empty()) {
    for (int i = 0; i < request.count; ++i) {
      order.instance = discovery::new_instance_id();
      InstanceOutcome outcome{id, order.instance, Outcome::unknown, ""};
      set_verdict(outcome, order_deployment(gateway, order, watch));
      result.outcomes.push_back(std::move(outcome));
    }
    return;
  }
  std::set<int> indexes(request.indexes.begin(), request.indexes.end());
  for (int i = 1; request.indexes.empty() && i <= request.count; ++i) indexes.insert(i);
  std::set<std::string> instances;
  for (const int index : indexes) instances.insert(named_instance_id(id, request.name, index));
  const auto there = locate(instances, {gateway});
  for (const int index : indexes) {
    order.index = index;
    order.instance = named_instance_id(id, request.name, index);
    InstanceOutcome outcome{id, order.instance, Outcome::failed, ""};
    if (!there.contains(order.instance)) {
      outcome.outcome = Outcome::unknown;
      set_verdict(outcome, order_deployment(gateway, order, watch));
    } else if (registry.get(options.paths.order(id, order.instance))) {
      outcome.reason = fmt::format(
          "{} {} is deployed there already; `iotcloud apply` changes it, `iotcloud undeploy` "
          "takes it away",
          request.name, index);
    } else {
      outcome.reason = fmt::format("{} {} is still being undeployed; try again in a moment", request.name, index);
    }
    result.outcomes.push_back(std::move(outcome));
  }
}

Master::Impl::MaybeVerdict Master::Impl::order_deployment(const GatewayStatus& gateway, OrderRecord order,
                                                          OutcomeWatch& watch) {
  if (!gateway.alive && (!options.record_for_lost_gateways || is_direct(gateway.record.id)))
    return OutcomeWatch::Verdict{Outcome::failed, lost_and_not_recorded_text};
  return written([&](const discovery::Lead& lead) -> MaybeVerdict {
    order.epoch = lead.epoch;
    registry.create(options.paths.order(gateway.record.id, order.instance), encode(order), true, lead.fence);
    if (!gateway.alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    watch.expect(order.instance, order.driver, std::nullopt);
    return std::nullopt;
  });
}

}  // namespace iotcloud::master
