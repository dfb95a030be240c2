#pragma once

#include <set>
#include <string>
#include <vector>

#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Drains gateways, and ends that again. Thread safe.
class Draining {
 public:
  explicit Draining(OrderDesk& desk) : desk_(desk) {}
  /// \param undo ends the draining. Does not throw.
  OrderResult drain(const GatewaySelection& selection, bool undo);

 private:
  OrderResult drain_all(const GatewaySelection& selection, bool undo);
  void add_made_by_rules(const std::set<discovery::GatewayId>& gateways, const std::set<discovery::InstanceId>& ordered,
                         std::vector<discovery::PlacedOrder>& orders);
  void mark(const discovery::GatewayId& gateway, bool undo, const discovery::Lead& lead);
  EarlyOutcome order(const LocatedInstance& where, const discovery::GatewayStatus& gateway, bool undo,
                     OutcomeWatch& watch);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
