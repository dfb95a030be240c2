#include <algorithm>
#include <set>
#include <utility>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/master/orders/deployments.h>
#include <iotcloud/master/orders/direct_gateways.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::OrderRecord;

namespace {

/// The properties of the instance with this number.
std::map<std::string, std::string> properties_of(const DeployRequest& request, int index) {
  auto properties = request.properties;
  for (const auto& own : request.own) {
    if (own.index != index) continue;
    for (const auto& [name, value] : own.properties) properties[name] = value;
  }
  return properties;
}

OrderRecord order_for(const DeployRequest& request) {
  OrderRecord order;
  static_cast<discovery::Deployment&>(order) = static_cast<const discovery::Deployment&>(request);
  return order;
}

std::optional<OrderResult> refuse_deployment(const DeployRequest& request) {
  if (auto refusal = refuse_plugin(request.plugin, request.sha256)) return refusal;
  if (!request.driver.empty() && !is_node_name(request.driver))
    return refuse(OrderRefusal::bad_request,
                  fmt::format("\"{}\" cannot be a driver's name: no '/' and no control characters", request.driver));
  if (request.count < 1 || request.count > DeployRequest::max_count)
    return refuse(OrderRefusal::bad_request,
                  fmt::format("count is {}, must be from 1 to {}", request.count, DeployRequest::max_count));
  if (request.name.empty() && (!request.indexes.empty() || !request.manager.empty()))
    return refuse(OrderRefusal::bad_request, "numbers of instances, and a manifest that they belong to, need a name");
  for (const auto& [what, text] :
       {std::pair("a deployment", &request.name), std::pair("a manifest", &request.manager)}) {
    if (!text->empty() && !is_node_name(*text))
      return refuse(OrderRefusal::bad_request,
                    fmt::format("\"{}\" cannot be the name of {}: no '/' and no control characters", *text, what));
  }
  for (const int index : request.indexes) {
    if (index < 1 || index > DeployRequest::max_count)
      return refuse(OrderRefusal::bad_request,
                    fmt::format("an instance's number is {}, must be from 1 to {}", index, DeployRequest::max_count));
  }
  auto largest = order_for(request);
  std::size_t longest_own = 0;
  for (const auto& own : request.own) {
    std::size_t length = 0;
    for (const auto& [name, value] : own.properties) length += name.size() + value.size();
    if (length < std::exchange(longest_own, std::max(length, longest_own))) continue;
    largest.properties = properties_of(request, own.index);
  }
  const auto size = encode(largest).size();
  if (size > largest_order)
    return refuse(OrderRefusal::bad_request,
                  fmt::format("properties and metadata take {} bytes, more than {}: pass large "
                              "things by the name of a file on the gateway",
                              size, largest_order));
  return std::nullopt;
}

/// Finds the gateways of a request. \return a refusal; nullopt: the gateways are in `targets`.
std::optional<OrderResult> find_targets(const DeployRequest& request, const std::vector<GatewayStatus>& known,
                                        std::vector<const GatewayStatus*>& targets) {
  std::set<discovery::GatewayId> seen;
  for (const auto& id : request.gateways) {
    const auto* gateway = find(known, id);
    if (!gateway) return refuse_gateway(id, known);
    if (gateway->draining)
      return refuse(OrderRefusal::bad_request,
                    fmt::format("gateway {0} is draining, so nothing is deployed on it; `iotcloud undrain {0}` ends "
                                "that",
                                id));
    if (seen.insert(id).second) targets.push_back(gateway);
  }
  if (!request.gateways.empty()) return std::nullopt;
  for (const auto& gateway : known) {
    if (!gateway.draining) targets.push_back(&gateway);
  }
  if (known.empty()) return refuse_gateway({}, known);
  if (targets.empty())
    return refuse(OrderRefusal::bad_request, "all gateways are draining; `iotcloud undrain GATEWAY` ends that");
  return std::nullopt;
}

/// Whether an instance runs as an order wants it that was given before, in all but its epoch.
bool is_as_wanted(const std::optional<discovery::DriverRecord>& record, const OrderRecord& before,
                  const OrderRecord& wanted) {
  const discovery::Deployment &now = before, &then = wanted;
  return now == then && record &&
         record->state == (wanted.active ? discovery::DriverState::active : discovery::DriverState::inactive);
}

}  // namespace

OrderResult Deployments::deploy(const DeployRequest& request) {
  return desk_.leadership.guarded([&] { return place(request); });
}

OrderResult Deployments::place(const DeployRequest& request) {
  if (auto refusal = refuse_deployment(request)) return *refusal;
  OrderResult result;
  OutcomeWatch watch(desk_.registry, desk_.options.paths,
                     request.active ? OutcomeWatch::Wanted::active : OutcomeWatch::Wanted::inactive);
  OrderDesk::DirectCalls calls;
  {
    const config::ReadLock lock(desk_.placing);
    const auto known = desk_.gateways();
    std::vector<const GatewayStatus*> targets;
    if (auto refusal = find_targets(request, known, targets)) return *refusal;
    for (const auto* gateway : targets) {
      const auto& id = gateway->record.id;
      if (desk_.is_direct(id) && !request.own.empty()) {
        result.outcomes.push_back({id,
                                   {},
                                   OrderOutcome::failed,
                                   "its gateway is of the original system, which takes no properties of single "
                                   "instances: deploy them one by one"});
      } else if (desk_.is_direct(id) && !request.sha256.empty()) {
        result.outcomes.push_back(
            {id, {}, OrderOutcome::failed, "its gateway is of the original system, which takes no plugin file"});
      } else if (!desk_.is_direct(id) || !gateway->alive) {
        order_on(*gateway, request, result, watch);
      } else if (!request.name.empty()) {
        result.outcomes.push_back({id,
                                   {},
                                   OrderOutcome::failed,
                                   "its gateway is of the original system, which knows no names: deploy without one"});
      } else {
        for (int i = 0; i < request.count; ++i)
          calls.push_back(std::async(std::launch::async, [this, id, &request] {
            return desk_.options.direct->deploy(id, request, desk_.limit(request.wait));
          }));
      }
    }
  }
  desk_.settle(result, watch, request.wait, "deploy", std::move(calls));
  return result;
}

void Deployments::order_on(const GatewayStatus& gateway, const DeployRequest& request, OrderResult& result,
                           OutcomeWatch& watch) {
  const auto& id = gateway.record.id;
  auto order = order_for(request);
  if (request.name.empty()) {
    for (int i = 1; i <= request.count; ++i) {
      order.instance = discovery::new_instance_id();
      order.properties = properties_of(request, i);
      InstanceOutcome outcome{id, order.instance, OrderOutcome::unknown, ""};
      OrderDesk::set_outcome(outcome, this->order(gateway, order, watch));
      result.outcomes.push_back(std::move(outcome));
    }
    return;
  }
  std::set<int> indexes(request.indexes.begin(), request.indexes.end());
  for (int i = 1; request.indexes.empty() && i <= request.count; ++i) indexes.insert(i);
  std::set<discovery::InstanceId> instances;
  for (const int index : indexes) instances.insert(discovery::named_instance_id(id, request.name, index));
  const auto there = desk_.book.locate(instances, {gateway});
  for (const int index : indexes) {
    order.index = index;
    order.properties = properties_of(request, index);
    order.instance = discovery::named_instance_id(id, request.name, index);
    InstanceOutcome outcome{id, order.instance, OrderOutcome::failed, ""};
    const bool runs = there.contains(order.instance);
    const auto before = runs ? desk_.book.get(id, order.instance) : std::nullopt;
    const bool ordered = before.has_value();
    const LocatedInstance* by_rule =
        runs && desk_.book.is_made_by_rule(there.at(order.instance)) ? &there.at(order.instance) : nullptr;
    // An instance that a frozen gateway runs without an order gets its order again, and goes on when the registry is
    // adopted.
    if (!runs || by_rule || (!ordered && !gateway.frozen.empty())) {
      outcome.outcome = OrderOutcome::unknown;
      OrderDesk::set_outcome(outcome, this->order(gateway, order, watch, by_rule));
    } else if (ordered && is_as_wanted(desk_.book.record_of(there.at(order.instance)), *before, order)) {
      outcome.outcome = OrderOutcome::done;
      outcome.reason = "unchanged: it is deployed so already";
      // If the gateway is lost, the instance's record is out of date, so the outcome is another one.
      OrderDesk::set_outcome(outcome, waiting(gateway));
    } else if (ordered) {
      outcome.reason = fmt::format(
          "{} {} is deployed there already, and differs or is not in its state; `iotcloud apply` changes it, `iotcloud "
          "undeploy` "
          "takes it away",
          request.name, index);
    } else {
      outcome.reason = fmt::format("{} {} is still being undeployed; try again in a moment", request.name, index);
    }
    result.outcomes.push_back(std::move(outcome));
  }
}

EarlyOutcome Deployments::order(const GatewayStatus& gateway, OrderRecord order, OutcomeWatch& watch,
                                const LocatedInstance* by_rule) {
  if (!gateway.alive && (!desk_.options.record_for_lost_gateways || desk_.is_direct(gateway.record.id)))
    return ReasonedOutcome{OrderOutcome::failed, lost_and_not_recorded_text};
  return desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
    order.epoch = lead.epoch;
    if (by_rule && desk_.book.get(gateway.record.id, order.instance)) {
      const auto take_over = [&](OrderRecord& word) { word = order; };
      if (auto early = desk_.book.rewrite_word(*by_rule, lead, take_over)) return early;
    } else {
      desk_.book.create(gateway.record.id, order, lead);
    }
    if (auto postponed = waiting(gateway)) return postponed;
    watch.expect(order.instance, order.driver, by_rule ? by_rule->record : std::nullopt);
    return std::nullopt;
  });
}

std::vector<OrderKind> deployment_orders() {
  return {order_kind<DeployRequest>("deploy", security::Role::admin, [](auto& services, const auto& order) {
    return services.deployments.deploy(order);
  })};
}

}  // namespace iotcloud::master
