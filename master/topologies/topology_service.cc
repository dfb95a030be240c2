#include <algorithm>
#include <set>
#include <utility>

#include <fmt/ranges.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/topologies/topology_service.h>
#include <iotcloud/master/topologies/topology_watch.h>

namespace iotcloud::master {

using discovery::Node;
using discovery::RegistryError;
using discovery::RegistryErrorCode;
using discovery::TopologyKill;
using discovery::TopologyOrder;
using discovery::WorkerRecord;
using std::chrono::milliseconds;

namespace {

/// As long as a client waits for an answer at most.
constexpr milliseconds longest_drain{600'000};
/// How long, after their drain, the workers of a killed topology have to close and to end.
constexpr milliseconds end_margin{10'000};

TopologyResult refuse_topology(OrderRefusal refusal, std::string text) {
  return {refusal, std::move(text), "", {}};
}

bool any_lives(const std::vector<std::string>& names, const std::vector<WorkerRecord>& workers) {
  return std::any_of(workers.begin(), workers.end(), [&](const WorkerRecord& worker) {
    return std::find(names.begin(), names.end(), worker.name) != names.end();
  });
}

/// Checks a requested parallelism against the components in the workers' records. \return what is wrong; empty:
/// nothing.
std::string check_parallelism(const TopologyRequest& request, const std::vector<WorkerRecord>& workers) {
  if (request.parallelism.empty()) return "no component is named: give at least one as COMPONENT=N";
  for (const auto& [component, parallelism] : request.parallelism) {
    for (const WorkerRecord& worker : workers) {
      if (worker.components.empty())
        continue;  // an older program, whose record has no components: it reports itself what it cannot do
      const auto found = worker.components.find(component);
      if (found == worker.components.end()) {
        std::vector<std::string> known;
        for (const auto& [name, shape] : worker.components)
          known.push_back(fmt::format("{} (1 to {})", name, shape.tasks));
        return fmt::format("topology {} has no component \"{}\"; there are {}", request.topology, component,
                           fmt::join(known, ", "));
      }
      if (parallelism < 1 || parallelism > found->second.tasks) {
        return fmt::format(
            "component {} can have a parallelism of 1 to {} (its tasks in each worker), not {}; more tasks are given "
            "by the key `tasks` in its YAML, or by further workers",
            component, found->second.tasks, parallelism);
      }
    }
  }
  return "";
}

}  // namespace

TopologyResult TopologyService::order(const TopologyRequest& request) {
  if (to_string(request.change).empty())
    return refuse_topology(OrderRefusal::bad_request,
                           "this master does not know that change of a topology; it is older than the client");
  auto bounded = request;
  bounded.drain = std::clamp(request.drain, milliseconds{0}, longest_drain);
  TopologyResult result;
  const auto refusal = desk_.leadership.guarded([&]() -> OrderResult {
    try {
      result = follow(bounded);
    } catch (const RegistryError& e) {
      if (e.code() == RegistryErrorCode::away || e.code() == RegistryErrorCode::fenced) throw;
      result = refuse_topology(OrderRefusal::bad_request, e.what());
    }
    return {};
  });
  if (refusal.refusal == OrderRefusal::none) return result;
  return {refusal.refusal, refusal.text, refusal.leader, {}};
}

std::optional<TopologyResult> TopologyService::refuse_unknown_topology(const discovery::TopologyName& name) {
  if (is_node_name(name)) {
    const auto record = desk_.registry.get(desk_.options.paths.topology(name));
    if (record && (!record->data.empty() || desk_.registry.get(desk_.options.paths.topology_order(name))))
      return std::nullopt;
    if (submissions_.stands(name)) return std::nullopt;
  }
  std::vector<discovery::TopologyName> known;
  for (const auto& topology : discovery::list_topologies(desk_.registry, desk_.options.paths))
    known.push_back(topology.record.name);
  return refuse_topology(OrderRefusal::unknown_topology,
                         known.empty() ? fmt::format("no topology \"{}\"; none runs", name)
                                       : fmt::format("no topology \"{}\"; there are {}", name, fmt::join(known, ", ")));
}

/// \throws config::Error when the order cannot be given.
TopologyService::ChangedOrder TopologyService::changed_order(const std::optional<Node>& node, std::int64_t known,
                                                             const TopologyRequest& request, const Workers& workers,
                                                             const discovery::Lead& lead, milliseconds wait) const {
  TopologyOrder order;
  const std::string path = desk_.options.paths.topology_order(request.topology);
  const bool ours = node && desk_.book.is_ours(path, node->data);
  if (ours) order = discovery::decode_topology_order(node->data, path);
  const bool old = ours && desk_.book.is_old(*node, order.given_ms, known);
  const bool forgets = node && (!ours || old);
  if (forgets && request.change == TopologyChange::rebalance) {
    throw config::Error((old ? "somebody wrote once more an old order that now stands for topology "
                             : "no trusted master has signed the order that stands for topology ") +
                        request.topology +
                        ", so it is not changed: activate or deactivate the topology, which takes that order's place");
  }
  if (old) {
    const TopologyOrder there = std::exchange(order, {});
    order.revision = there.revision;
    order.epoch = there.epoch;
    order.given_ms = there.given_ms;
  }
  if (order.epoch > lead.epoch) throw config::Error("a later master has given orders for it; this one's lead is over");
  std::int64_t last = order.revision;
  const std::int64_t last_given = std::max(order.given_ms, known);
  for (const WorkerRecord& worker : workers) last = std::max(last, std::min(worker.revision, most_revision));
  if (order.kill && !any_lives(order.kill->workers, workers)) order = TopologyOrder{};  // that run is over
  if (order.kill && request.change != TopologyChange::kill)
    throw config::Error("topology " + request.topology + " is being killed");
  order.revision = last + 1;
  order.epoch = lead.epoch;
  order.given_ms = std::max(config::system_clock().wall_ms(), last_given);
  switch (request.change) {
    case TopologyChange::activate:
      order.active = true;
      break;
    case TopologyChange::deactivate:
      order.active = false;
      break;
    case TopologyChange::rebalance:
      for (const auto& [component, parallelism] : request.parallelism) order.parallelism[component] = parallelism;
      break;
    case TopologyChange::kill:
      order.kill = TopologyKill{};
      for (const WorkerRecord& worker : workers) order.kill->workers.push_back(worker.name);
      order.kill->drain_ms = request.drain.count();
      order.kill->awaited_until_ms = config::system_clock().wall_ms() + wait.count() + 1000;
      break;
  }
  return {order, forgets};
}

TopologyService::ChangedOrder TopologyService::write_order(const TopologyRequest& request, const Workers& workers,
                                                           const discovery::Lead& lead, milliseconds wait) {
  const std::string path = desk_.options.paths.topology_order(request.topology);
  while (!desk_.leadership.closing().stop_requested()) {
    const auto known = desk_.book.last_given(path);  // before the node is read
    const auto node = desk_.registry.get(path);
    ChangedOrder change = changed_order(node, known, request, workers, lead, wait);
    try {
      desk_.book.put_topology(path, node, change.order, lead);
      return change;
    } catch (const RegistryError& e) {
      // The order changed meanwhile: read it again.
      if (e.code() != RegistryErrorCode::bad_version && e.code() != RegistryErrorCode::exists &&
          e.code() != RegistryErrorCode::no_node)
        throw;
    }
  }
  throw config::Error("this master is stopping");
}

TopologyResult TopologyService::follow(const TopologyRequest& request) {
  const auto lead = desk_.leadership.lead();
  if (!lead) return refuse_topology(OrderRefusal::not_leading, lost_lead_text);
  if (auto refusal = refuse_unknown_topology(request.topology)) return *refusal;
  const bool kill = request.change == TopologyChange::kill;
  // From now on the pools start no worker of it, and none again.
  const auto not_marked =
      kill ? submissions_.mark_killed(request.topology, request.drain, *lead) : std::optional<OrderResult>();
  if (not_marked && not_marked->refusal != OrderRefusal::unknown_topology)
    return refuse_topology(not_marked->refusal, not_marked->text);
  const bool submitted = kill && !not_marked;
  const auto workers = discovery::list_workers(desk_.registry, desk_.options.paths, request.topology);
  if (request.change == TopologyChange::rebalance) {
    if (workers.empty())
      return refuse_topology(OrderRefusal::bad_request,
                             fmt::format("no worker of topology {} runs, so what its components "
                                         "can have is not known; start one first",
                                         request.topology));
    if (const auto problem = check_parallelism(request, workers); !problem.empty())
      return refuse_topology(OrderRefusal::bad_request, problem);
  }
  TopologyResult result;
  if (kill && workers.empty()) {
    if (submitted) await_pools(request.topology, result);
    discovery::remove_topology(desk_.registry, desk_.options.paths, request.topology, lead->fence);
    result.text +=
        (result.text.empty() ? "" : "; ") + std::string("no worker ran; what was ordered for it is forgotten");
    if (submitted) submissions_.remember(request.topology, "kill", result.text);
    return result;
  }
  const milliseconds wait = desk_.limit(
      kill && !request.wait ? std::max(desk_.options.outcome_timeout, request.drain + end_margin) : request.wait);
  const auto [order, forgets] = write_order(request, workers, *lead, wait);
  if (workers.empty()) result.text = "no worker runs; those that start will follow";
  if (forgets && !kill) {
    result.text += (result.text.empty() ? "" : "; ") +
                   std::string(
                       "somebody else's or an old order stood there and is forgotten, with the parallelism that it may "
                       "have given: `iotcloud topology rebalance` gives it again");
  }

  TopologyWatch watch(desk_.registry, desk_.options.paths, request.topology, order.revision, kill);
  for (const WorkerRecord& worker : workers) watch.expect(worker.name);
  const auto outcomes = watch.wait(wait, desk_.leadership.closing());
  for (const WorkerRecord& worker : workers) {
    const auto& outcome = outcomes.at(worker.name);
    result.outcomes.push_back({worker.name, worker.host, outcome.outcome, outcome.reason});
  }
  if (submitted) await_pools(request.topology, result);
  if (kill) clear_killed(request.topology, *lead, result);
  if (submitted) submissions_.remember(request.topology, "kill", result.summary());
  for (const auto& outcome : result.outcomes)
    config::process_metrics()
        .counter("iotcloud_master_topology_orders_total", "Orders to topologies by what became of them in each worker",
                 {{"order", to_string(request.change)}, {"outcome", to_string(outcome.outcome)}})
        .add();
  logger.info("topology {}: {}: {}", request.topology, to_string(request.change), result.summary());
  return result;
}

/// Waits until the pools have given up the places of a killed topology.
void TopologyService::await_pools(const discovery::TopologyName& topology, TopologyResult& result) {
  if (!submissions_.await_end(topology, end_margin)) result.text = "a pool is still ending a worker of it";
}

/// Removes the order of a killed topology when all workers that were to end are gone; otherwise the last of them
/// removes it.
void TopologyService::clear_killed(const discovery::TopologyName& topology, const discovery::Lead& lead,
                                   TopologyResult& result) {
  if (std::any_of(result.outcomes.begin(), result.outcomes.end(),
                  [](const auto& o) { return o.outcome == OrderOutcome::unknown; }))
    return;
  try {
    if (discovery::remove_topology(desk_.registry, desk_.options.paths, topology, lead.fence)) return;
    desk_.registry.remove(desk_.options.paths.topology_order(topology), -1, lead.fence);
    std::vector<std::string> names;
    for (const auto& worker : discovery::list_workers(desk_.registry, desk_.options.paths, topology))
      names.push_back(worker.name);
    result.text = fmt::format("started after the order, and running: {}", fmt::join(names, ", "));
  } catch (const RegistryError& e) {
    result.text = fmt::format("the workers ended, but the order stands: {}", e.what());
  }
}

}  // namespace iotcloud::master
