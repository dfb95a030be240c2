#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/manifest.h>

namespace iotcloud::master::cli {

/// The registered gateways and the present orders: what a manifest is compared with.
struct Fleet {
  /// A registered gateway.
  struct Gateway {
    discovery::GatewayId id;
    bool draining = false;
    bool original = false;  ///< a gateway of the original system: it knows no deployment names, so a manifest skips it
    bool lost = false;      ///< its process is not alive now
  };
  /// An instance that has an order.
  struct Instance : discovery::Deployment {
    discovery::GatewayId gateway;
    discovery::InstanceId instance;
    int index = 0;                    ///< 0: deployed without a name
    std::string failure;              ///< why it has failed; empty: it has not
    bool ordered = false;             ///< its gateway is lost, and has not followed the order
    std::vector<std::string> hidden;  ///< keys of properties whose values only an admin may see
  };
  std::vector<Gateway> gateways;
  std::vector<Instance> instances;
};

/// The kinds of steps, each for one instance, in the order in which a gateway's steps are done. The updates and changes
/// of a deployment are one order for all gateways, one after the other.
enum class FleetStepKind {
  undeploy,
  stop,
  adopt,     ///< the instance, which a person deployed, belongs to the manifest from now on
  replace,   ///< another driver: it is undeployed, then deployed
  update,    ///< another plugin or changed bytes, under the same id; rolled back if it does not come up
  change,    ///< other properties: it is created anew under the same id; rolled back if it does not come up
  describe,  ///< other metadata: it goes on running
  start,     ///< the instance was stopped, or has failed
  deploy,
};
std::string to_string(FleetStepKind kind);

/// One thing to do on one gateway.
struct FleetStep {
  FleetStepKind kind = FleetStepKind::deploy;
  discovery::GatewayId gateway;
  std::string name;
  int index = 0;
  discovery::InstanceId instance;               ///< empty for `deploy`
  std::size_t deployment = 0;                   ///< index in Manifest::deployments; unused for `undeploy`
  std::vector<std::string> what;                ///< the differences, for people: "rate: 5 -> 10"; secrets are not shown
  std::map<std::string, std::string> metadata;  ///< for `describe`: the changes; an empty text removes the key
  /// For `change`: the gateway is lost, so nobody can see how it goes; it follows when it comes back.
  bool recorded_only = false;
};

/// Something that the manifest wants and that cannot be done.
struct FleetProblem {
  discovery::GatewayId gateway;
  std::string name;  ///< of a deployment
  std::string text;  ///< the problem, and how to mend it
};

/// The differences between a manifest and a fleet.
struct FleetPlan {
  std::vector<FleetStep> steps;  ///< sorted by gateway, then in the order of FleetStepKind
  std::vector<FleetProblem> problems;
  std::vector<FleetStep> kept;  ///< what pruning would undeploy, when FleetPlanOptions::prune is false
  /// Draining gateways, which get no instances of deployments to all gateways.
  std::vector<discovery::GatewayId> passed_by;
  std::size_t same = 0;     ///< number of instances that are as the manifest wants them
  std::size_t ordered = 0;  ///< number of wanted instances whose lost gateways have not followed the order
  /// Keys of hidden properties, which are assumed to be as the manifest wants them.
  std::set<std::string> not_compared;
};

/// Permissions for a plan to change things that the manifest does not name.
struct FleetPlanOptions {
  bool prune = true;   ///< undeploy instances that the manifest deployed and names no more
  bool adopt = false;  ///< take over instances that others deployed under names of the manifest
};

/// Plans the steps that make the fleet as the manifest says, and no others. An instance that the manifest did not
/// deploy is never touched, unless it has a name of the manifest's and may be adopted.
FleetPlan make_plan(const Manifest& manifest, const Fleet& fleet, const FleetPlanOptions& options);

}  // namespace iotcloud::master::cli
