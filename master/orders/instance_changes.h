#pragma once

#include <functional>
#include <string>

#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Changes the orders of deployed instances. Thread safe; public functions do not throw.
class InstanceChanges {
 public:
  explicit InstanceChanges(OrderDesk& desk) : desk_(desk) {}
  OrderResult change(const InstanceSelection& selection, InstanceAction action);
  OrderResult update_metadata(const InstanceSelection& selection, const MetadataChanges& changes);
  OrderResult change_deployment(const DeploymentChange& change);

 private:
  OrderResult change_selected(const InstanceSelection& selection, InstanceAction action);
  EarlyOutcome order(const LocatedInstance& where, const discovery::GatewayStatus& gateway, InstanceAction action,
                     OutcomeWatch& watch);
  EarlyOutcome clear_away(const LocatedInstance& where, InstanceAction action);

  /// Rewrites the orders of the selected instances. \param alter changes one order, and returns its outcome if that is
  /// known already; nullopt: the watch waits for it. \param direct_text the outcome's reason for instances on gateways
  /// of the original system, whose orders cannot be rewritten.
  OrderResult rewrite(const InstanceSelection& selection, OutcomeWatch& watch, const char* direct_text,
                      const std::function<EarlyOutcome(discovery::OrderRecord&)>& alter, const std::string& name);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
