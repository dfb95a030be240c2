#include <algorithm>

#include <fmt/ranges.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/order_times.h>
#include <iotcloud/master/orders/order_book.h>

namespace iotcloud::master {

using discovery::GatewayId;
using discovery::GatewayStatus;
using discovery::InstanceId;
using discovery::Lead;
using discovery::OrderRecord;
using discovery::RegistryError;
using discovery::RegistryErrorCode;

namespace {

ReasonedOutcome of_later_master() {
  return {OrderOutcome::failed, "a later master has given orders for it; this one's lead is over"};
}

/// Somebody put it there once more, and would have this master sign it. \param remembered this master has given a later
/// one, which an adoption makes it forget
ReasonedOutcome of_earlier_time(const GatewayId& gateway, bool remembered) {
  return {OrderOutcome::failed,
          "a master has signed the order that stands there, but it is out of date: somebody wrote an old one once "
          "more, or copied the registry (or its clock is minutes ahead), so it is not changed: undeploy the instance "
          "and deploy it again, or `iotcloud registry import --replace` a backup" +
              (remembered ? fmt::format("; if the registry was put back, and its orders are meant as they stand, "
                                        "`iotcloud registry adopt {}`",
                                        gateway)
                          : "")};
}

/// Whoever wrote it would have this master sign it.
ReasonedOutcome of_nobody_trusted() {
  return {OrderOutcome::failed,
          "no trusted master has signed the order that stands there, so it is not changed: undeploy the instance and "
          "deploy it again, or `iotcloud registry import --replace` a backup"};
}

}  // namespace

void LastGiven::note(const std::string& path, std::int64_t given_ms) {
  const config::MutexLock lock(mutex_);
  if (newer_.size() >= many) older_ = std::exchange(newer_, {});
  auto& time = newer_[path];
  time = std::max(time, given_ms);
}

std::int64_t LastGiven::at(const std::string& path) const {
  const config::MutexLock lock(mutex_);
  for (const Times* times : {&newer_, &older_}) {
    if (const auto found = times->find(path); found != times->end()) return found->second;
  }
  return 0;
}

void LastGiven::forget(const std::string& above) {
  const std::string prefix = above + "/";
  const config::MutexLock lock(mutex_);
  for (Times* times : {&newer_, &older_}) {
    auto at = times->lower_bound(prefix);
    while (at != times->end() && at->first.starts_with(prefix)) at = times->erase(at);
  }
}

const GatewayStatus* find(const std::vector<GatewayStatus>& gateways, const GatewayId& id) {
  const auto at = std::find_if(gateways.begin(), gateways.end(), [&](const auto& g) { return g.record.id == id; });
  return at == gateways.end() ? nullptr : &*at;
}

OrderResult refuse_gateway(const GatewayId& id, const std::vector<GatewayStatus>& known) {
  if (known.empty())
    return refuse(OrderRefusal::unknown_gateway,
                  "no gateway is registered: start iotcloud-gateway with the same registry and zk.root");
  std::vector<GatewayId> ids;
  ids.reserve(known.size());
  for (const auto& gateway : known) ids.push_back(gateway.record.id);
  return refuse(OrderRefusal::unknown_gateway,
                fmt::format("no gateway \"{}\"; known gateways: {}", id, fmt::join(ids, ", ")));
}

std::map<InstanceId, LocatedInstance> OrderBook::locate(const std::set<InstanceId>& instances,
                                                        const std::vector<GatewayStatus>& known) {
  std::map<InstanceId, LocatedInstance> located;
  const auto ordered = ordered_on(instances, known);
  for (const auto& [instance, gateway] : ordered)
    located.emplace(instance, LocatedInstance{instance, gateway, {}, std::nullopt});
  auto paths = discovery::list_instances(registry_, paths_);
  std::erase_if(paths,
                [&](const auto& path) { return !instances.contains(InstanceId(path.substr(path.rfind('/') + 1))); });
  auto nodes = registry_.get_readable(paths);
  for (std::size_t i = 0; i < paths.size(); ++i) {
    if (!nodes[i] || nodes[i]->data.empty()) continue;  // its channels come first
    const auto record = discovery::driver_of(nodes[i], paths[i]);
    if (!record) continue;
    const bool is_ordered = ordered.contains(record->instance);
    auto& found = located[record->instance];
    if (is_ordered && !record->gateway.empty() && record->gateway != found.gateway) continue;
    // Of two, the later one was made by somebody who knew the id.
    if (found.record && found.record->created < nodes[i]->created) continue;
    found.instance = record->instance;
    found.driver = record->name;
    if (!is_ordered) found.gateway = record->gateway;
    found.record = std::move(nodes[i]);
  }
  return located;
}

/// The gateways on which the instances have orders.
std::map<InstanceId, GatewayId> OrderBook::ordered_on(const std::set<InstanceId>& instances,
                                                      const std::vector<GatewayStatus>& known) {
  std::vector<std::string> parents;
  parents.reserve(known.size());
  for (const auto& gateway : known) parents.push_back(paths_.orders(gateway.record.id));
  const auto names = registry_.children_of_readable(parents);
  std::map<InstanceId, std::vector<GatewayId>> candidates;
  for (std::size_t i = 0; i < known.size(); ++i) {
    for (const auto& name : names[i].value_or(std::vector<std::string>())) {
      const InstanceId instance(name);
      if (instances.contains(instance)) candidates[instance].push_back(known[i].record.id);
    }
  }
  std::map<InstanceId, GatewayId> ordered;
  for (const auto& [instance, gateways] : candidates)
    ordered.emplace(instance, gateways.size() == 1 ? gateways.front() : true_place(instance, gateways));
  return ordered;
}

/// Where an instance is of which several gateways have an order: one that this master's like have signed counts, and
/// then the one that was made first. Whoever makes a gateway of a name that nobody has can make orders there, too.
GatewayId OrderBook::true_place(const InstanceId& instance, const std::vector<GatewayId>& gateways) {
  std::vector<std::string> paths;
  paths.reserve(gateways.size());
  for (const auto& gateway : gateways) paths.push_back(paths_.order(gateway, instance));
  const auto nodes = registry_.get_readable(paths);
  std::optional<std::pair<bool, std::int64_t>> first;
  GatewayId place = gateways.front();
  for (std::size_t i = 0; i < paths.size(); ++i) {
    if (!nodes[i]) continue;
    const std::pair rank{!is_ours(paths[i], nodes[i]->data), nodes[i]->created};
    if (first && *first < rank) continue;
    first = rank;
    place = gateways[i];
  }
  return place;
}

std::optional<OrderResult> OrderBook::find_selected(const InstanceSelection& selection,
                                                    const std::vector<GatewayStatus>& known,
                                                    std::vector<LocatedInstance>& instances) {
  if (selection.instances.empty())
    return refuse(OrderRefusal::bad_request, "no instance is named: give at least one id");
  for (const auto& id : selection.gateways) {
    if (!find(known, id)) return refuse_gateway(id, known);
  }
  auto located = locate({selection.instances.begin(), selection.instances.end()}, known);
  std::set<InstanceId> seen;
  for (const auto& id : selection.instances) {
    if (!seen.insert(id).second) continue;
    const auto where = located.find(id);
    if (where == located.end())
      return refuse(OrderRefusal::unknown_instance,
                    fmt::format("no driver instance \"{}\"; `iotcloud drivers` lists them", id));
    if (!selection.gateways.empty() && std::find(selection.gateways.begin(), selection.gateways.end(),
                                                 where->second.gateway) == selection.gateways.end())
      return refuse(OrderRefusal::unknown_instance,
                    fmt::format("instance {} is on gateway {}, not on {}", id, where->second.gateway,
                                fmt::join(selection.gateways, ", ")));
    instances.push_back(std::move(where->second));
  }
  return std::nullopt;
}

std::optional<discovery::DriverRecord> OrderBook::record_of(const LocatedInstance& where) const {
  if (!where.record) return std::nullopt;
  return discovery::driver_of(where.record, paths_.instance(where.driver, where.instance));
}

std::optional<OrderRecord> OrderBook::get(const GatewayId& gateway, const InstanceId& instance) {
  const auto path = paths_.order(gateway, instance);
  const auto node = registry_.get(path);
  if (!node) return std::nullopt;
  return discovery::decode_order(node->data, path);
}

bool OrderBook::is_old(const discovery::Node& node, std::int64_t given_ms, std::int64_t known) const {
  if (!seal_ || !is_sealed_ || given_ms == known) return false;
  return given_ms < known || discovery::written_late(node, given_ms);
}

void OrderBook::create(const GatewayId& gateway, OrderRecord order, const Lead& lead) {
  const auto path = paths_.order(gateway, order.instance);
  if (seal_) order.given_ms = std::max(config::system_clock().wall_ms(), given_.at(path));
  registry_.create(path, sealed(path, encode(order)), true, lead.fence);
  note_given(path, order.given_ms);
}

void OrderBook::put_signed(const std::string& path, const std::optional<discovery::Node>& node,
                           const std::string& order, std::int64_t given_ms, const Lead& lead) {
  const std::string bytes = sealed(path, order);
  if (node) {
    registry_.set(path, bytes, node->version, lead.fence);
  } else {
    registry_.create(path, bytes, true, lead.fence);
  }
  note_given(path, given_ms);
}

void OrderBook::put_topology(const std::string& path, const std::optional<discovery::Node>& node,
                             const discovery::TopologyOrder& order, const Lead& lead) {
  put_signed(path, node, encode(order), order.given_ms, lead);
}

void OrderBook::put_submission(const std::string& path, const std::optional<discovery::Node>& node,
                               const discovery::Submission& submission, const Lead& lead) {
  put_signed(path, node, encode(submission), submission.given_ms, lead);
}

/// Says with this master's signature that the order is removed, for gateways that follow signed orders only.
void OrderBook::announce_removal(const LocatedInstance& where, const OrderRecord* order, const Lead& lead) {
  if (!seal_) return;
  const auto order_path = paths_.order(where.gateway, where.instance);
  const auto given_before = std::max(order != nullptr ? order->given_ms : 0, given_.at(order_path));
  const discovery::OrderRemoval removal{where.instance, lead.epoch,
                                        std::max(config::system_clock().wall_ms(), given_before + 1)};
  const auto path = paths_.removal(where.gateway, where.instance);
  discovery::put(registry_, path, sealed(path, encode(removal)), lead.fence);
  note_given(order_path, removal.given_ms);
}

EarlyOutcome OrderBook::remove(const LocatedInstance& where, const Lead& lead) {
  const auto path = paths_.order(where.gateway, where.instance);
  while (!leadership_.closing().stop_requested()) {
    const auto node = registry_.get(path);
    if (!node) {
      if (where.record) announce_removal(where, nullptr, lead);  // somebody else removed it
      break;
    }
    if (is_ours(path, node->data)) {
      const auto order = discovery::decode_order(node->data, path);
      if (order.epoch > lead.epoch) return of_later_master();
      announce_removal(where, &order, lead);
    } else {
      announce_removal(where, nullptr, lead);
    }
    try {
      registry_.remove(path, node->version, lead.fence);
      break;
    } catch (const RegistryError& e) {
      if (e.code() != RegistryErrorCode::bad_version) throw;  // changed meanwhile: look again
    }
  }
  if (where.record) return std::nullopt;
  return ReasonedOutcome{OrderOutcome::done, "its gateway had not taken it up yet"};
}

/// The word about an instance of a rule before anybody said one; nullopt: its record does not say that a rule made it.
std::optional<OrderRecord> OrderBook::first_word(const LocatedInstance& where) const {
  const auto record = record_of(where);
  if (!record || record->made_by.empty()) return std::nullopt;
  OrderRecord word;
  word.instance = where.instance;
  word.made_by = record->made_by;
  word.driver = record->name;
  word.plugin = record->plugin;
  word.name = record->deployment;
  word.index = record->index;
  return word;
}

bool OrderBook::is_made_by_rule(const LocatedInstance& where) {
  const auto order = get(where.gateway, where.instance);
  return order ? !order->made_by.empty() : first_word(where).has_value();
}

EarlyOutcome OrderBook::rewrite_word(const LocatedInstance& where, const Lead& lead,
                                     const std::function<void(OrderRecord&)>& alter) {
  if (!get(where.gateway, where.instance)) {
    auto word = first_word(where);
    if (!word) return ReasonedOutcome{OrderOutcome::failed, "it is being undeployed"};
    alter(*word);
    word->epoch = lead.epoch;
    create(where.gateway, *std::move(word), lead);
    return std::nullopt;
  }
  const auto altering = [&](OrderRecord& order) -> EarlyOutcome {
    alter(order);
    return std::nullopt;
  };
  return rewrite_standing(where, lead, altering, Standing::is_kept);
}

EarlyOutcome OrderBook::rewrite(const LocatedInstance& where, const Lead& lead,
                                const std::function<void(OrderRecord&)>& alter, Standing standing) {
  const auto of_rule = [](const std::string& made_by) {
    return ReasonedOutcome{
        OrderOutcome::failed,
        fmt::format("{} of its gateway made it: change that in the gateway's file (provisioning)", made_by)};
  };
  const auto altering = [&](OrderRecord& order) -> EarlyOutcome {
    if (!order.made_by.empty()) return of_rule(order.made_by);
    alter(order);
    return std::nullopt;
  };
  if (const auto word = first_word(where); word && !get(where.gateway, where.instance)) return of_rule(word->made_by);
  return rewrite_standing(where, lead, altering, standing);
}

EarlyOutcome OrderBook::rewrite_standing(const LocatedInstance& where, const Lead& lead,
                                         const std::function<EarlyOutcome(OrderRecord&)>& alter, Standing standing) {
  const auto path = paths_.order(where.gateway, where.instance);
  while (!leadership_.closing().stop_requested()) {
    const auto known = given_.at(path);  // before the node is read: another order may be given meanwhile
    const auto node = registry_.get(path);
    if (!node) return ReasonedOutcome{OrderOutcome::failed, "it is being undeployed"};
    const bool ours = is_ours(path, node->data);
    if (!ours && standing == Standing::is_kept) return of_nobody_trusted();
    auto order = discovery::decode_order(node->data, path);
    if (ours && order.epoch > lead.epoch) return of_later_master();
    if (ours && standing == Standing::is_kept && is_old(*node, order.given_ms, known))
      return of_earlier_time(where.gateway, order.given_ms < known && !discovery::written_late(*node, order.given_ms));
    const auto given_before = std::max(ours ? order.given_ms : 0, known);
    if (auto refusal = alter(order)) return refusal;
    order.epoch = lead.epoch;
    if (seal_) order.given_ms = std::max(config::system_clock().wall_ms(), given_before + 1);
    const std::string bytes = encode(order);
    if (bytes.size() > largest_order)
      return ReasonedOutcome{OrderOutcome::failed,
                             fmt::format("its order would take {} bytes, more than {}", bytes.size(), largest_order)};
    try {
      registry_.set(path, sealed(path, bytes), node->version, lead.fence);
      note_given(path, order.given_ms);
      return std::nullopt;
    } catch (const RegistryError& e) {
      if (e.code() != RegistryErrorCode::bad_version) throw;  // changed meanwhile: look again
    }
  }
  return ReasonedOutcome{OrderOutcome::failed, "this master is stopping"};
}

}  // namespace iotcloud::master
