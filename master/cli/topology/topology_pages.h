#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/cli/topology/worker_pages.h>

namespace iotcloud::master::cli {

/// The reports of one topology's workers about their tasks, read once.
class TopologyPages {
 public:
  using Json = nlohmann::ordered_json;
  TopologyPages(const discovery::TopologyStatus& topology, WorkerPages& workers);

  /// Why a worker's page could not be read, one text for each.
  const std::vector<std::string>& problems() const { return problems_; }
  /// The graph, sources first; empty when no page could be read.
  const Json& components() const { return components_; }
  /// The brokers of the workers whose pages could be read: {"worker", "broker", "url", "state", "since_ms", "why"}.
  Json brokers() const;
  /// What is on its way to the spouts of these workers: {"worker", "component", "age_s", "backlog", "topic", "most"}.
  Json arrivals() const;
  /// What hinders components in these workers now, as they say it: {"worker", "component", "text"}.
  Json troubles() const;
  /// The tasks of one component on all workers: counts added up, latency p50 of the task with the most samples, p99 and
  /// max of the worst task, capacity of the busiest.
  Json sum(const std::string& component) const;
  /// All components, each with its sum and its tasks.
  Json metrics() const;
  std::size_t workers() const { return pages_.size(); }

 private:
  Json tasks_of(const std::string& component) const;
  Json all(const char* list) const;  ///< the elements of that list of all pages, each with its worker

  std::string topology_;
  std::vector<Json> pages_;
  std::vector<std::string> problems_;
  Json components_ = Json::array();
};

/// A worker's page, which may come from anybody who stands in the registry as a worker. \throws RequestFailed,
/// TopologyPages::Json::exception
TopologyPages::Json parse_page(const std::string& text);

/// Prints a row for each component, and one for each of its tasks.
void print_metrics(std::ostream& out, const TopologyPages& pages, const TopologyPages::Json& metrics);
/// Adds to the sum of each component what it did a second since an earlier answer: `rate` with `emitted` and
/// `executed`. A component that began to count anew meanwhile has none.
void add_rates(TopologyPages::Json& metrics, const TopologyPages::Json& before, double seconds);

}  // namespace iotcloud::master::cli
