#include <map>

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

/// The bolts that keep tuples until a window or a checkpoint ends.
std::string keepers(const Topology& topology) {
  std::string text;
  for (const ComponentSpec& component : topology.components) {
    if (component.holds.count() == 0) continue;
    text += fmt::format("{}{} (for up to {} ms)", text.empty() ? "" : ", ", component.id,
                        std::chrono::ceil<std::chrono::milliseconds>(component.holds).count());
  }
  return text;
}

}  // namespace

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
