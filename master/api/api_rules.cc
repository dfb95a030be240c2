#include "iotcloud/master/master_types.h"
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/orders/order_kinds.h>

namespace iotcloud::master {

using rpc::MethodRules;
using rpc::RefusalForm;
using security::Role;

const MethodRules& api_rules() {
  static const MethodRules rules = [] {
    MethodRules all{
        {"authenticate", {Role::anyone, RefusalForm::response}},
        // reads
        {"getSites", {Role::viewer}},
        {"getSite", {Role::viewer}},
        {"getSensors", {Role::viewer}},
        {"getAllSensors", {Role::viewer}},
        {"getStatus", {Role::viewer, RefusalForm::error}},
        {"listGateways", {Role::viewer, RefusalForm::error}},
        {"listDrivers", {Role::viewer, RefusalForm::error}},
        {"getTopologyHistory", {Role::viewer, RefusalForm::error}},
        {"readWorkerLog", {Role::viewer, RefusalForm::error}},
        {"listPools", {Role::viewer, RefusalForm::error}},
        {"listTopologies", {Role::viewer, RefusalForm::error}},
        {"getHistory", {Role::viewer, RefusalForm::error}},
        {"readLog", {Role::viewer, RefusalForm::error}},
        {"listPlugins", {Role::viewer, RefusalForm::error}},
        {"readWorkerPage", {Role::viewer, RefusalForm::error}},
        {"lookAtChannel", {Role::viewer, RefusalForm::error}},
        // This also shows the properties that drivers were deployed with; only an admin sees the values of those that
        // look like secrets (listing/secret_properties.h).
        {"listOrders", {Role::operating, RefusalForm::error, false}},
        {"exportOrders", {Role::admin, RefusalForm::error}},
        // change how deployed instances run
        {"startSensor", {Role::operating, RefusalForm::response}},
        {"startAllSensor", {Role::operating, RefusalForm::response}},
        {"stopSiteSensors", {Role::operating, RefusalForm::response}},
        {"stopAllSensors", {Role::operating, RefusalForm::response}},
        {"orderTopology", {Role::operating, RefusalForm::order}},
        // reaches a device, as a topology's command does
        {"handMessage", {Role::operating, RefusalForm::error}},
        // decide which programs run
        {"deploySensor", {Role::admin, RefusalForm::response}},
        {"unDeploySensor", {Role::admin, RefusalForm::response}},
        {"unDeployAllSensor", {Role::admin, RefusalForm::response}},
        {"offerPlugin", {Role::admin, RefusalForm::order}},
        {"offerLibrary", {Role::admin, RefusalForm::order}},
        {"sendPlugin", {Role::admin, RefusalForm::order, false}},
        {"finishPlugin", {Role::admin, RefusalForm::order}},
        // any kind of order; api_handler.cc checks the role that the kind requires
        {"giveOrder", {Role::operating, RefusalForm::order}},
    };
    for (const auto& kind : order_kinds()) all[kind.name] = {kind.role, RefusalForm::order};
    return all;
  }();
  return rules;
}

}  // namespace iotcloud::master
