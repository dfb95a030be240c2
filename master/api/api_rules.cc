#include "iotcloud/master/master_types.h"
#include <iotcloud/master/api/api_handler.h>

namespace iotcloud::master {

using config::MethodRules;
using config::RefusalForm;
using config::Role;

const MethodRules& api_rules() {
  static const MethodRules rules{
      {"authenticate", {Role::anyone, RefusalForm::response}},
      // reads
      {"getSites", {Role::viewer}},
      {"getSite", {Role::viewer}},
      {"getSensors", {Role::viewer}},
      {"getAllSensors", {Role::viewer}},
      {"getStatus", {Role::viewer, RefusalForm::error}},
      {"listGateways", {Role::viewer, RefusalForm::error}},
      {"listDrivers", {Role::viewer, RefusalForm::error}},
      {"listTopologies", {Role::viewer, RefusalForm::error}},
      {"getHistory", {Role::viewer, RefusalForm::error}},
      {"readLog", {Role::viewer, RefusalForm::error}},
      // reads also the properties that drivers were deployed with; of those that look like secrets only an admin is
      // told the values (listing/secret_properties.h)
      {"listOrders", {Role::operating, RefusalForm::error, false}},
      // how what is there runs
      {"startSensor", {Role::operating, RefusalForm::response}},
      {"startAllSensor", {Role::operating, RefusalForm::response}},
      {"stopSiteSensors", {Role::operating, RefusalForm::response}},
      {"stopAllSensors", {Role::operating, RefusalForm::response}},
      {"start", {Role::operating, RefusalForm::order}},
      {"stop", {Role::operating, RefusalForm::order}},
      {"updateMetadata", {Role::operating, RefusalForm::order}},
      {"drain", {Role::operating, RefusalForm::order}},
      {"undrain", {Role::operating, RefusalForm::order}},
      {"orderTopology", {Role::operating, RefusalForm::order}},
      // which programs run
      {"deploySensor", {Role::admin, RefusalForm::response}},
      {"unDeploySensor", {Role::admin, RefusalForm::response}},
      {"unDeployAllSensor", {Role::admin, RefusalForm::response}},
      {"deploy", {Role::admin, RefusalForm::order}},
      {"undeploy", {Role::admin, RefusalForm::order}},
      {"changeDeployment", {Role::admin, RefusalForm::order}},
      {"offerPlugin", {Role::admin, RefusalForm::order}},
      {"sendPlugin", {Role::admin, RefusalForm::order, false}},
      {"finishPlugin", {Role::admin, RefusalForm::order}},
      {"update", {Role::admin, RefusalForm::order}},
  };
  return rules;
}

}  // namespace iotcloud::master
