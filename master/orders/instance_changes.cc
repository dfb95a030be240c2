#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/master/orders/direct_gateways.h>
#include <iotcloud/master/orders/instance_changes.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::Lead;
using discovery::OrderRecord;
using security::Role;

namespace {

OutcomeWatch::Wanted wanted_by(InstanceAction action) {
  switch (action) {
    case InstanceAction::undeploy:
      return OutcomeWatch::Wanted::gone;
    case InstanceAction::start:
      return OutcomeWatch::Wanted::active;
    case InstanceAction::stop:
      return OutcomeWatch::Wanted::inactive;
  }
  return OutcomeWatch::Wanted::gone;
}

/// The outcome for an instance of a rule that a person has undeployed, or of which nothing is found any more.
ReasonedOutcome not_there_already(InstanceAction action) {
  const bool done = action == InstanceAction::undeploy;
  return {done ? OrderOutcome::done : OrderOutcome::failed,
          "it does not run, and its rule makes it again only when it is started (iotcloud start)"};
}

}  // namespace

OrderResult InstanceChanges::change(const InstanceSelection& selection, InstanceAction action) {
  return desk_.leadership.guarded([&] { return change_selected(selection, action); });
}

OrderResult InstanceChanges::change_selected(const InstanceSelection& selection, InstanceAction action) {
  OrderResult result;
  OutcomeWatch watch(desk_.registry, desk_.options.paths, wanted_by(action));
  std::vector<LocatedInstance> instances;
  OrderDesk::DirectCalls calls;
  {
    // With this lock either a drain sees the orders that are written here, or this code sees the drain's mark.
    const config::ReadLock lock(desk_.placing);
    const auto known = desk_.gateways();
    if (auto refusal = desk_.book.find_selected(selection, known, instances)) return *refusal;
    for (const auto& where : instances) {
      const auto* gateway = find(known, where.gateway);
      if (gateway && gateway->alive && desk_.is_direct(where.gateway)) {
        calls.push_back(std::async(std::launch::async, [this, &where, action, &selection] {
          return desk_.options.direct->change(where.gateway, where.instance, action, desk_.limit(selection.wait));
        }));
        continue;
      }
      InstanceOutcome outcome{where.gateway, where.instance, OrderOutcome::unknown, ""};
      OrderDesk::set_outcome(outcome, gateway ? order(where, *gateway, action, watch) : clear_away(where, action));
      result.outcomes.push_back(std::move(outcome));
    }
  }
  desk_.settle(result, watch, selection.wait, to_string(action), std::move(calls));
  return result;
}

EarlyOutcome InstanceChanges::order(const LocatedInstance& where, const GatewayStatus& gateway, InstanceAction action,
                                    OutcomeWatch& watch) {
  if (!gateway.alive && (!desk_.options.record_for_lost_gateways || desk_.is_direct(where.gateway)))
    return ReasonedOutcome{OrderOutcome::failed, lost_and_not_recorded_text};
  return desk_.leadership.written([&](const Lead& lead) -> EarlyOutcome {
    const bool later = gateway.draining && action == InstanceAction::start;
    const auto alter = [&](OrderRecord& order) {
      order.drained = later && !order.active;
      order.active = action == InstanceAction::start && !order.drained;
      if (!order.made_by.empty()) order.withheld = action == InstanceAction::undeploy;
    };
    if (desk_.book.is_made_by_rule(where)) {
      if (!where.record && action != InstanceAction::start) return not_there_already(action);
      if (auto early = desk_.book.rewrite_word(where, lead, alter)) return early;
    } else if (auto early = action == InstanceAction::undeploy ? desk_.book.remove(where, lead)
                                                               : desk_.book.rewrite(where, lead, alter)) {
      return early;
    }
    if (later)
      return ReasonedOutcome{
          OrderOutcome::pending,
          fmt::format("gateway is draining; it starts after that (iotcloud undrain {})", where.gateway)};
    if (auto postponed = waiting(gateway)) return postponed;
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

/// Handles an instance whose gateway is not registered any more and cannot follow an order: the master itself removes
/// the record that the gateway left.
EarlyOutcome InstanceChanges::clear_away(const LocatedInstance& where, InstanceAction action) {
  if (action != InstanceAction::undeploy)
    return ReasonedOutcome{OrderOutcome::failed, "its gateway is not registered any more"};
  return desk_.leadership.written([&](const Lead& lead) -> EarlyOutcome {
    discovery::remove_tree(desk_.registry, desk_.options.paths.instance(where.driver, where.instance), lead.fence);
    return ReasonedOutcome{OrderOutcome::done, "its gateway is not registered any more; its record is removed"};
  });
}

OrderResult InstanceChanges::rewrite(const InstanceSelection& selection, OutcomeWatch& watch, const char* direct_text,
                                     const std::function<EarlyOutcome(OrderRecord&)>& alter, const std::string& name) {
  const auto known = desk_.gateways();
  std::vector<LocatedInstance> instances;
  if (auto refusal = desk_.book.find_selected(selection, known, instances)) return *refusal;
  OrderResult result;
  desk_.order_each(instances, result, [&](const LocatedInstance& where) -> EarlyOutcome {
    const auto* gateway = find(known, where.gateway);
    if (auto obstacle = desk_.obstacle(where, gateway, direct_text)) return obstacle;
    return desk_.leadership.written([&](const Lead& lead) -> EarlyOutcome {
      EarlyOutcome altered;
      if (auto early = desk_.book.rewrite(where, lead, [&](OrderRecord& order) { altered = alter(order); }))
        return early;
      if (altered) return altered;
      if (auto postponed = waiting(*gateway)) return postponed;
      watch.expect(where.instance, where.driver, where.record);
      return std::nullopt;
    });
  });
  desk_.settle(result, watch, selection.wait, name);
  return result;
}

OrderResult InstanceChanges::update_metadata(const InstanceSelection& selection, const MetadataChanges& changes) {
  return desk_.leadership.guarded([&] {
    if (changes.empty()) return refuse(OrderRefusal::bad_request, "nothing is to change: give at least one KEY=VALUE");
    if (changes.contains("")) return refuse(OrderRefusal::bad_request, "a key of metadata has at least one character");
    OutcomeWatch watch(desk_.registry, desk_.options.paths, changes);
    const auto alter = [&](OrderRecord& order) -> EarlyOutcome {
      for (const auto& [key, value] : changes) {
        if (value.empty()) {
          order.metadata.erase(key);
        } else {
          order.metadata[key] = value;
        }
      }
      return std::nullopt;
    };
    return rewrite(selection, watch, "its gateway is of the original system, which takes no metadata", alter,
                   "metadata");
  });
}

OrderResult InstanceChanges::change_deployment(const DeploymentChange& change) {
  return desk_.leadership.guarded([&] {
    if (!change.properties && !change.manager) return refuse(OrderRefusal::bad_request, "nothing is to change");
    if (change.manager && !change.manager->empty() && !is_node_name(*change.manager))
      return refuse(
          OrderRefusal::bad_request,
          fmt::format("\"{}\" cannot be the name of a manifest: no '/' and no control characters", *change.manager));
    OutcomeWatch watch(desk_.registry, desk_.options.paths, OutcomeWatch::Wanted::anew);
    const auto alter = [&](OrderRecord& order) -> EarlyOutcome {
      const bool made_anew = change.properties && *change.properties != order.properties;
      if (change.properties) order.properties = *change.properties;
      if (change.manager) order.manager = *change.manager;
      if (made_anew) return std::nullopt;
      return ReasonedOutcome{OrderOutcome::done, ""};
    };
    return rewrite({change.instances, {}, change.wait}, watch, "its gateway is of the original system: deploy it again",
                   alter, "change");
  });
}

namespace {

/// Stops instances, then starts those that have stopped. An instance whose stop failed is left as it is.
OrderResult restart(InstanceChanges& changes, const InstanceSelection& selection) {
  OrderResult result = changes.change(selection, InstanceAction::stop);
  InstanceSelection stopped{{}, {}, selection.wait};
  for (const auto& outcome : result.outcomes) {
    if (outcome.outcome == OrderOutcome::done) stopped.instances.push_back(outcome.instance);
  }
  if (stopped.instances.empty()) return result;
  const OrderResult started = changes.change(stopped, InstanceAction::start);
  for (auto& outcome : result.outcomes) {
    if (outcome.outcome != OrderOutcome::done) continue;
    const auto found = std::find_if(started.outcomes.begin(), started.outcomes.end(),
                                    [&](const auto& other) { return other.instance == outcome.instance; });
    if (found != started.outcomes.end()) {
      outcome = *found;
    } else {
      outcome.outcome = OrderOutcome::failed;
      outcome.reason = "it is stopped, and the order to start it was refused: " + started.text;
    }
  }
  return result;
}

}  // namespace

std::vector<OrderKind> change_orders() {
  const auto change = [](InstanceAction action) {
    return [action](auto& services, const auto& order) { return services.changes.change(order, action); };
  };
  return {
      order_kind<InstanceSelection>("undeploy", Role::admin, change(InstanceAction::undeploy)),
      order_kind<InstanceSelection>("start", Role::operating, change(InstanceAction::start)),
      order_kind<InstanceSelection>("stop", Role::operating, change(InstanceAction::stop)),
      order_kind<InstanceSelection>("restart", Role::operating,
                                    [](auto& services, const auto& order) { return restart(services.changes, order); }),
      order_kind<MetadataOrder>(
          "updateMetadata", Role::operating,
          [](auto& services, const auto& order) { return services.changes.update_metadata(order, order.changes); }),
      order_kind<DeploymentChange>("changeDeployment", Role::admin, [](auto& services, const auto& order) {
        return services.changes.change_deployment(order);
      })};
}

}  // namespace iotcloud::master
