#pragma once

#include <optional>
#include <vector>

#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Orders new instances. Thread safe.
class Deployments {
 public:
  explicit Deployments(OrderDesk& desk) : desk_(desk) {}
  /// Does not throw.
  OrderResult deploy(const DeployRequest& request);

 private:
  OrderResult place(const DeployRequest& request);
  /// Orders all instances of a request on one gateway.
  void order_on(const discovery::GatewayStatus& gateway, const DeployRequest& request, OrderResult& result,
                OutcomeWatch& watch);
  /// \param by_rule what a rule of the gateway has made there by this name, which the order takes over; null: nothing
  EarlyOutcome order(const discovery::GatewayStatus& gateway, discovery::OrderRecord order, OutcomeWatch& watch,
                     const LocatedInstance* by_rule = nullptr);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
