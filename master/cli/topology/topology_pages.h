#pragma once

#include <chrono>
#include <iosfwd>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "iotcloud/master/master_types.h"

namespace iotcloud::master::cli {

/// GETs a page of a worker. \param address "127.0.0.1:port". \return the body. \throws Failed.
std::string get_page(const std::string& address, const std::string& target);
/// For a query of a page.
std::string encode_query(const std::string& text);

/// Waits. \return false when interrupted.
bool pause(std::chrono::duration<double> time);

/// Whether this machine can reach a worker's pages; why not. Empty: it can.
std::string unreachable(const wire::TWorker& worker);

/// What the workers of one topology say of their tasks, read once.
class TopologyPages {
 public:
  using Json = nlohmann::ordered_json;
  explicit TopologyPages(const wire::TTopology& topology);

  /// Why a worker's page could not be read, one text for each.
  const std::vector<std::string>& problems() const { return problems_; }
  /// The graph, sources first; empty when no page could be read.
  const Json& components() const { return components_; }
  /// The tasks of one component on all workers: counts added up, latency p50 of the task with the most samples, p99 and
  /// max of the worst task, capacity of the busiest.
  Json sum(const std::string& component) const;
  /// Each component with its sum and its tasks.
  Json metrics() const;
  std::size_t workers() const { return pages_.size(); }

 private:
  Json tasks_of(const std::string& component) const;

  std::string topology_;
  std::vector<Json> pages_;
  std::vector<std::string> problems_;
  Json components_ = Json::array();
};

/// A row for each component, and one for each of its tasks.
void print_metrics(std::ostream& out, const TopologyPages& pages);

}  // namespace iotcloud::master::cli
