#include <algorithm>
#include <set>

#include <fmt/ranges.h>

#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::Lead;
using discovery::OrderRecord;
using discovery::RegistryError;
using discovery::RegistryErrorCode;

namespace {

OutcomeWatch::Wanted wanted_by(Change change) {
  switch (change) {
    case Change::undeploy:
      return OutcomeWatch::Wanted::gone;
    case Change::start:
      return OutcomeWatch::Wanted::active;
    case Change::stop:
      return OutcomeWatch::Wanted::inactive;
  }
  return OutcomeWatch::Wanted::gone;
}

OutcomeWatch::Verdict of_later_master() {
  return {Outcome::failed, "a later master has given orders for it; this one's lead is over"};
}

}  // namespace

OrderResult Master::undeploy(const InstanceSelection& selection) {
  return impl_->guarded([&] { return impl_->change(selection, Change::undeploy); });
}

OrderResult Master::start(const InstanceSelection& selection) {
  return impl_->guarded([&] { return impl_->change(selection, Change::start); });
}

OrderResult Master::stop(const InstanceSelection& selection) {
  return impl_->guarded([&] { return impl_->change(selection, Change::stop); });
}

std::map<std::string, Master::Impl::Located> Master::Impl::locate(const std::set<std::string>& instances,
                                                                  const std::vector<GatewayStatus>& known) {
  using Names = std::vector<std::string>;
  const auto drivers = registry.children(options.paths.sensors).value_or(Names{});
  Names parents;
  for (const auto& driver : drivers) parents.push_back(options.paths.driver(driver));
  const auto records = registry.children_of_all(parents);
  std::vector<Located> found;
  Names paths;
  for (std::size_t i = 0; i < drivers.size(); ++i) {
    for (const auto& instance : records[i].value_or(Names{})) {
      if (!instances.contains(instance)) continue;
      found.push_back({instance, "", drivers[i], std::nullopt});
      paths.push_back(options.paths.instance(drivers[i], instance));
    }
  }
  auto nodes = registry.get_all(paths);
  std::map<std::string, Located> located;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!nodes[i] || nodes[i]->data.empty()) continue;
    found[i].gateway = discovery::decode_driver(nodes[i]->data, paths[i]).gateway;
    found[i].record = std::move(nodes[i]);
    located.emplace(found[i].instance, std::move(found[i]));
  }
  if (located.size() == instances.size()) return located;
  Names orders;
  for (const auto& gateway : known) orders.push_back(options.paths.orders(gateway.record.id));
  const auto ordered = registry.children_of_all(orders);
  for (std::size_t i = 0; i < known.size(); ++i) {
    for (const auto& instance : ordered[i].value_or(Names{})) {
      if (instances.contains(instance)) located.emplace(instance, Located{instance, known[i].record.id, "", {}});
    }
  }
  return located;
}

std::optional<OrderResult> Master::Impl::find_selected(const InstanceSelection& selection,
                                                       const std::vector<GatewayStatus>& known,
                                                       std::vector<Located>& instances) {
  if (selection.instances.empty()) return refuse(Refusal::bad_request, "no instance is named: give at least one id");
  for (const auto& id : selection.gateways) {
    if (!find(known, id)) return refuse_gateway(id, known);
  }
  auto located = locate({selection.instances.begin(), selection.instances.end()}, known);
  std::set<std::string> seen;
  for (const auto& id : selection.instances) {
    if (!seen.insert(id).second) continue;
    const auto where = located.find(id);
    if (where == located.end())
      return refuse(Refusal::unknown_instance,
                    fmt::format("no driver instance \"{}\"; `iotcloud drivers` lists them", id));
    if (!selection.gateways.empty() && std::find(selection.gateways.begin(), selection.gateways.end(),
                                                 where->second.gateway) == selection.gateways.end())
      return refuse(Refusal::unknown_instance, fmt::format("instance {} is on gateway {}, not on {}", id,
                                                           where->second.gateway, fmt::join(selection.gateways, ", ")));
    instances.push_back(std::move(where->second));
  }
  return std::nullopt;
}

OrderResult Master::Impl::change(const InstanceSelection& selection, Change change) {
  OrderResult result;
  OutcomeWatch watch(registry, options.paths, wanted_by(change));
  std::vector<Located> instances;
  DirectCalls calls;
  std::shared_lock lock(placing);  // what starts is seen by a drain, or sees it
  const auto known = discovery::list_gateways(registry, options.paths);
  if (auto refusal = find_selected(selection, known, instances)) return *refusal;
  for (const auto& where : instances) {
    const auto* gateway = find(known, where.gateway);
    if (gateway && gateway->alive && is_direct(where.gateway)) {
      calls.push_back(std::async(std::launch::async, [this, &where, change, &selection] {
        return options.direct->change(where.gateway, where.instance, change, limit(selection.wait));
      }));
      continue;
    }
    InstanceOutcome outcome{where.gateway, where.instance, Outcome::unknown, ""};
    set_verdict(outcome, gateway ? order_change(where, *gateway, change, watch) : clear_away(where, change));
    result.outcomes.push_back(std::move(outcome));
  }
  lock.unlock();
  settle(result, watch, calls, selection.wait, to_string(change));
  return result;
}

Master::Impl::MaybeVerdict Master::Impl::order_change(const Located& where, const GatewayStatus& gateway, Change change,
                                                      OutcomeWatch& watch) {
  if (!gateway.alive && (!options.record_for_lost_gateways || is_direct(where.gateway)))
    return OutcomeWatch::Verdict{Outcome::failed, lost_and_not_recorded_text};
  return written([&](const Lead& lead) -> MaybeVerdict {
    const bool later = gateway.draining && change == Change::start;
    const auto verdict =
        change == Change::undeploy ? remove_order(where, lead) : rewrite_order(where, lead, [&](OrderRecord& order) {
          order.drained = later && !order.active;
          order.active = change == Change::start && !order.drained;
        });
    if (verdict) return verdict;
    if (later)
      return OutcomeWatch::Verdict{
          Outcome::pending,
          fmt::format("gateway is draining; it starts after that (iotcloud undrain {})", where.gateway)};
    if (!gateway.alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

/// Nobody is left to follow an order: what the gateway left behind is removed here.
Master::Impl::MaybeVerdict Master::Impl::clear_away(const Located& where, Change change) {
  if (change != Change::undeploy)
    return OutcomeWatch::Verdict{Outcome::failed, "its gateway is not registered any more"};
  return written([&](const Lead& lead) -> MaybeVerdict {
    discovery::remove_tree(registry, options.paths.instance(where.driver, where.instance), lead.fence);
    return OutcomeWatch::Verdict{Outcome::done, "its gateway is not registered any more; its record is removed"};
  });
}

Master::Impl::MaybeVerdict Master::Impl::remove_order(const Located& where, const Lead& lead) {
  const auto path = options.paths.order(where.gateway, where.instance);
  while (!closing.stop_requested()) {
    const auto node = registry.get(path);
    if (!node) break;
    if (discovery::decode_order(node->data, path).epoch > lead.epoch) return of_later_master();
    try {
      registry.remove(path, node->version, lead.fence);
      break;
    } catch (const RegistryError& e) {
      if (e.code() != RegistryErrorCode::bad_version) throw;  // changed meanwhile: look again
    }
  }
  if (where.record) return std::nullopt;
  return OutcomeWatch::Verdict{Outcome::done, "its gateway had not taken it up yet"};
}

Master::Impl::MaybeVerdict Master::Impl::rewrite_order(const Located& where, const Lead& lead,
                                                       const std::function<void(OrderRecord&)>& alter) {
  const auto path = options.paths.order(where.gateway, where.instance);
  while (!closing.stop_requested()) {
    const auto node = registry.get(path);
    if (!node) return OutcomeWatch::Verdict{Outcome::failed, "it is being undeployed"};
    auto order = discovery::decode_order(node->data, path);
    if (order.epoch > lead.epoch) return of_later_master();
    alter(order);
    order.epoch = lead.epoch;
    const std::string bytes = encode(order);
    if (bytes.size() > largest_order)
      return OutcomeWatch::Verdict{
          Outcome::failed, fmt::format("its order would take {} bytes, more than {}", bytes.size(), largest_order)};
    try {
      registry.set(path, bytes, node->version, lead.fence);
      return std::nullopt;
    } catch (const RegistryError& e) {
      if (e.code() != RegistryErrorCode::bad_version) throw;  // changed meanwhile: look again
    }
  }
  return OutcomeWatch::Verdict{Outcome::failed, "this master is stopping"};
}

}  // namespace iotcloud::master
