#include <algorithm>
#include <map>
#include <tuple>

#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/master/orders/backups.h>
#include <iotcloud/master/orders/order_kind.h>

namespace iotcloud::master {

using discovery::GatewayId;
using discovery::OrderRecord;
using discovery::TopologyName;
using discovery::TopologyOrder;

namespace {

const ReasonedOutcome another{OrderOutcome::failed, "another order stands there; --replace puts this one in its place"};
const ReasonedOutcome unchanged{OrderOutcome::done, "it stood there already"};

}  // namespace

Backup Backups::make() const {
  auto& registry = desk_.registry;
  const auto& paths = desk_.options.paths;
  std::map<GatewayId, GatewayBackup> gateways;
  for (auto& [gateway, order] : discovery::list_orders(registry, paths, {}, discovery::Unreadable::throws))
    gateways[gateway].orders.push_back(std::move(order));
  for (const auto& gateway : desk_.gateways()) {
    if (gateway.draining) gateways[gateway.record.id].draining = true;
  }
  Backup backup;
  backup.made_ms = config::system_clock().wall_ms();
  for (auto& [id, gateway] : gateways) {
    gateway.gateway = id;
    std::sort(gateway.orders.begin(), gateway.orders.end(), [](const OrderRecord& a, const OrderRecord& b) {
      return std::tie(a.name, a.index, a.instance) < std::tie(b.name, b.index, b.instance);
    });
    backup.gateways.push_back(std::move(gateway));
  }
  backup.missing_plugins = sent_plugins(backup.gateways);
  for (const auto& name : registry.children(paths.topologies).value_or(std::vector<std::string>())) {
    const TopologyName topology(name);
    const auto path = paths.topology_order(topology);
    const auto node = registry.get(path);
    if (!node) continue;
    auto order = discovery::decode_topology_order(node->data, path);
    if (!order.kill) backup.topologies.push_back({topology, std::move(order)});
  }
  for (auto& [name, standing] : discovery::list_submissions(registry, paths)) {
    if (!standing.submission.killed) backup.submissions.push_back(std::move(standing.submission));
  }
  return backup;
}

OrderResult Backups::import(const ImportRequest& request) {
  return desk_.leadership.guarded([&] { return import_all(request); });
}

OrderResult Backups::import_all(const ImportRequest& request) {
  check(request, "the order to import");
  OrderResult result;
  const config::ReadLock lock(desk_.placing);
  const auto known = desk_.gateways();
  for (const auto& part : request.gateways) {
    if (part.draining) {
      const auto lead = desk_.leadership.lead();
      if (!lead) return refuse(OrderRefusal::not_leading, lost_lead_text);
      mark_draining(part.gateway, *lead);
    }
    const auto* gateway = find(known, part.gateway);
    const auto waits =
        gateway != nullptr
            ? waiting(*gateway)
            : ReasonedOutcome{OrderOutcome::pending, "gateway is not registered; it follows the order when it is"};
    for (const auto& order : part.orders) {
      auto& outcome =
          result.outcomes.emplace_back(InstanceOutcome{part.gateway, order.instance, OrderOutcome::unknown, ""});
      OrderDesk::set_outcome(outcome, desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
        auto placed = place(part.gateway, order, request.replace, lead);
        if (placed.outcome == OrderOutcome::done && waits) {
          placed.reason += (placed.reason.empty() ? "" : "; ") + waits->reason;
        }
        return placed;
      }));
    }
  }
  for (const auto& topology : request.topologies) {
    auto& outcome = result.outcomes.emplace_back(
        InstanceOutcome{{}, discovery::InstanceId("topologies/" + topology.topology.str()), OrderOutcome::unknown, ""});
    OrderDesk::set_outcome(outcome, desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
      return place(topology, request.replace, lead);
    }));
  }
  for (const auto& submission : request.submissions) {
    auto& outcome = result.outcomes.emplace_back(
        InstanceOutcome{{}, discovery::InstanceId("submitted/" + submission.name.str()), OrderOutcome::unknown, ""});
    OrderDesk::set_outcome(outcome, desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
      return place(submission, request.replace, lead);
    }));
  }
  desk_.tell(result, "import");
  return result;
}

void Backups::mark_draining(const GatewayId& gateway, const discovery::Lead& lead) {
  const auto path = desk_.options.paths.gateway_draining(gateway);
  if (desk_.registry.get(path)) return;
  desk_.registry.create(path, encode(discovery::DrainRecord{config::system_clock().wall_ms(), lead.epoch}), true,
                        lead.fence);
}

ReasonedOutcome Backups::place(const GatewayId& gateway, OrderRecord order, bool replace, const discovery::Lead& lead) {
  const auto there = desk_.book.get(gateway, order.instance);
  if (!there) {
    order.epoch = lead.epoch;
    desk_.book.create(gateway, order, lead);
    return {OrderOutcome::done, ""};
  }
  order.epoch = there->epoch;
  order.given_ms = there->given_ms;
  // With `replace` an equal order is written again if this master signs: the present one may be unsigned, from before
  // this fleet had keys.
  if (order == *there && !(replace && desk_.book.seals())) return unchanged;
  if (!replace) return another;
  const LocatedInstance where{order.instance, gateway, {}, std::nullopt};
  const auto outcome = desk_.book.rewrite(
      where, lead, [&](OrderRecord& present) { present = order; }, OrderBook::Standing::is_replaced);
  return outcome.value_or(ReasonedOutcome{OrderOutcome::done, "it took another order's place"});
}

ReasonedOutcome Backups::place(const TopologyBackup& topology, bool replace, const discovery::Lead& lead) {
  const auto path = desk_.options.paths.topology_order(topology.topology);
  TopologyOrder order = topology.order;
  const auto node = desk_.registry.get(path);
  if (node) {
    const auto there = discovery::decode_topology_order(node->data, path);
    const bool same = order.active == there.active && order.parallelism == there.parallelism && !there.kill;
    if (same && !(replace && desk_.book.seals())) return unchanged;
    if (!replace) return another;
    if (desk_.book.is_ours(path, node->data)) {
      order.revision = std::max(order.revision, there.revision);
      order.given_ms = there.given_ms;
    }
  }
  // Workers follow an order that is newer than theirs only.
  for (const auto& worker : discovery::list_workers(desk_.registry, desk_.options.paths, topology.topology))
    order.revision = std::max(order.revision, std::min(worker.revision, most_revision));
  ++order.revision;
  order.epoch = lead.epoch;
  order.given_ms = std::max({config::system_clock().wall_ms(), node ? order.given_ms : 0, desk_.book.last_given(path)});
  order.kill.reset();
  desk_.book.put_topology(path, node, order, lead);
  return {OrderOutcome::done, node ? "it took another order's place" : ""};
}

/// What was submitted runs again as it was ordered last: an update that was under way is over.
ReasonedOutcome Backups::place(discovery::Submission submission, bool replace, const discovery::Lead& lead) {
  const auto path = desk_.options.paths.submission(submission.name);
  const auto known = desk_.book.last_given(path);
  const auto node = desk_.registry.get(path);
  std::int64_t given_before = known;
  if (node) {
    const auto there = discovery::decode_submission(node->data, path);
    const bool same = there.version == submission.version && there.workers == submission.workers && !there.killed;
    if (same && !(replace && desk_.book.seals())) return unchanged;
    if (!there.killed && !replace) return another;
    if (desk_.book.is_ours(path, node->data)) {
      submission.last_number = std::max(submission.last_number, there.last_number);
      given_before = std::max(given_before, there.given_ms);
    }
  }
  // Under a number of its own, so that no pool takes it for what it had under that one.
  submission.version.number = ++submission.last_number;
  submission.pending = 0;
  submission.epoch = lead.epoch;
  submission.given_ms = std::max(config::system_clock().wall_ms(), given_before + 1);
  desk_.book.put_submission(path, node, submission, lead);
  return {OrderOutcome::done, node ? "it took another order's place" : ""};
}

std::vector<OrderKind> backup_orders() {
  return {order_kind<ImportRequest>("import", security::Role::admin, [](auto& services, const auto& request) {
    return services.backups.import(request);
  })};
}

}  // namespace iotcloud::master
