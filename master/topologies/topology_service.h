#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/master/orders/order_desk.h>
#include <iotcloud/master/orders/submissions.h>
#include <iotcloud/master/topologies/topology_orders.h>

namespace iotcloud::master {

/// Orders to topologies. Thread safe.
class TopologyService {
 public:
  TopologyService(OrderDesk& desk, Submissions& submissions) : desk_(desk), submissions_(submissions) {}
  /// Does not throw.
  TopologyResult order(const TopologyRequest& request);

 private:
  using Workers = std::vector<discovery::WorkerRecord>;
  struct ChangedOrder {
    discovery::TopologyOrder order;  ///< as it is to be from now on
    bool forgets = false;            ///< nothing is left of the order that stood there
  };
  TopologyResult follow(const TopologyRequest& request);
  std::optional<TopologyResult> refuse_unknown_topology(const discovery::TopologyName& name);
  /// \param known when this master gave the last order, as it knew before it read the node
  ChangedOrder changed_order(const std::optional<discovery::Node>& node, std::int64_t known,
                             const TopologyRequest& request, const Workers& workers, const discovery::Lead& lead,
                             std::chrono::milliseconds wait) const;
  ChangedOrder write_order(const TopologyRequest& request, const Workers& workers, const discovery::Lead& lead,
                           std::chrono::milliseconds wait);
  void await_pools(const discovery::TopologyName& topology, TopologyResult& result);
  void clear_killed(const discovery::TopologyName& topology, const discovery::Lead& lead, TopologyResult& result);

  OrderDesk& desk_;
  Submissions& submissions_;
};

}  // namespace iotcloud::master
