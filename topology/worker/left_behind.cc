#include <map>
#include <set>

#include <fmt/format.h>

#include <iotcloud/topology/worker/left_behind.h>

namespace iotcloud::topology {

namespace {

/// "12 of in, 3 of other"
std::string list(const std::map<std::string, std::size_t>& counts, const char* word) {
  std::string text;
  for (const auto& [component, count] : counts)
    text += fmt::format("{}{} {} {}", text.empty() ? "" : ", ", count, word, component);
  return text;
}

/// "mean (for up to 10000 ms)"
std::string keeper(const ComponentSpec& component) {
  if (component.holds == Bolt::until_others_come) return component.id + " (until enough others have come)";
  return fmt::format("{} (for up to {} ms)", component.id,
                     std::chrono::ceil<std::chrono::milliseconds>(component.holds).count());
}

/// The bolts that keep tuples until a window or a checkpoint ends.
std::string keepers(const Topology& topology) {
  std::string text;
  for (const ComponentSpec& component : topology.components) {
    if (component.holds.count() > 0) text += (text.empty() ? "" : ", ") + keeper(component);
  }
  return text;
}

}  // namespace

std::map<std::string, std::string> keepers_by_spout(const Topology& topology) {
  std::map<std::string, std::set<std::string>> spouts_of;  // by component: the spouts whose tuples reach it
  std::map<std::string, std::string> keepers;
  for (const ComponentSpec& component : topology.components) {  // sources come before the bolts that they feed
    auto& spouts = spouts_of[component.id];
    if (component.spout) spouts.insert(component.id);
    for (const InputSpec& input : component.inputs)
      spouts.insert(spouts_of[input.from].begin(), spouts_of[input.from].end());
    if (component.holds.count() == 0) continue;
    for (const std::string& spout : spouts) {
      auto& text = keepers[spout];
      text += (text.empty() ? "" : ", ") + keeper(component);
    }
  }
  return keepers;
}

std::string left_behind(const Topology& topology, const Snapshot& snapshot) {
  std::map<std::string, std::size_t> under_way, waiting;
  for (const TaskSnapshot& task : snapshot.tasks) {
    if (task.pending > 0) under_way[task.component] += task.pending;
    if (task.queue_depth > 0) waiting[task.component] += task.queue_depth;
  }
  if (under_way.empty() && waiting.empty()) return "";
  std::string text = "tuples under way: " + (under_way.empty() ? "none that is tracked" : list(under_way, "of"));
  if (!waiting.empty()) text += "; waiting: " + list(waiting, "before");
  if (const std::string kept = keepers(topology); !kept.empty() && !under_way.empty())
    text += "; these bolts keep tuples by design until a window or checkpoint ends: " + kept;
  return under_way.empty() ? text : text + "; spouts that acknowledge read them again";
}

}  // namespace iotcloud::topology
