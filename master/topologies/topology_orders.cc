#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/master/topologies/topology_orders.h>

namespace iotcloud::master {

std::string to_string(TopologyChange change) {
  switch (change) {
    case TopologyChange::activate:
      return "activate";
    case TopologyChange::deactivate:
      return "deactivate";
    case TopologyChange::rebalance:
      return "rebalance";
    case TopologyChange::kill:
      return "kill";
  }
  return "";
}

bool TopologyResult::all_done() const {
  return refusal == OrderRefusal::none &&
         std::all_of(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == OrderOutcome::done; });
}

std::string TopologyResult::summary() const {
  if (refusal != OrderRefusal::none) return text;
  const auto done =
      std::count_if(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == OrderOutcome::done; });
  std::string line = fmt::format("{} of {} workers done", done, outcomes.size());
  for (const auto& o : outcomes) {
    if (o.outcome != OrderOutcome::done) line += fmt::format("; {}: {}: {}", o.worker, to_string(o.outcome), o.reason);
  }
  return text.empty() ? line : line + "; " + text;
}

}  // namespace iotcloud::master
