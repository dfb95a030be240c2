#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/manifest.h>

namespace iotcloud::master::cli {

/// A fleet as it is ordered now.
struct Fleet {
  struct Gateway {
    std::string id;
    bool draining = false;
    bool original = false;  ///< of the original system, which knows no names: a manifest is not for it
    bool lost = false;      ///< it does not answer now
  };
  struct Instance {
    std::string gateway;
    std::string instance;  ///< id
    std::string name;      ///< empty: deployed without one
    int index = 0;
    std::string manager;  ///< the manifest that it belongs to; empty: a person deployed it
    std::string driver;
    std::string plugin;
    bool active = true;
    std::map<std::string, std::string> properties;
    std::map<std::string, std::string> metadata;
    std::string failure;                ///< why it has failed; empty: it has not
    std::string sha256{};               ///< of a plugin that was sent; empty: of the gateway's folder
    std::vector<std::string> hidden{};  ///< keys of properties whose values only an admin is told
  };
  std::vector<Gateway> gateways;
  std::vector<Instance> instances;
};

/// What is to be done to one instance, in the order in which it is done on a gateway. Updates are of all gateways, one
/// after the other.
enum class StepKind {
  undeploy,
  stop,
  adopt,     ///< it belongs to the manifest from now on
  replace,   ///< another driver: undeployed, then deployed
  update,    ///< another plugin, or other bytes of it, under its id; back again when it does not come up with it
  change,    ///< other properties: made anew under its id
  describe,  ///< other metadata: it notices nothing
  start,     ///< it is stopped, or has failed
  deploy,
};
std::string to_string(StepKind kind);

struct Step {
  StepKind kind = StepKind::deploy;
  std::string gateway;
  std::string name;
  int index = 0;
  std::string instance;                         ///< id; empty with deploy
  std::size_t deployment = 0;                   ///< of the manifest; nothing with undeploy
  std::vector<std::string> what;                ///< what differs, for people: "rate: 5 -> 10". Secrets are not shown
  std::map<std::string, std::string> metadata;  ///< describe: what to change; an empty text takes the key away
};

/// What the manifest wants and cannot be done.
struct Problem {
  std::string gateway;
  std::string name;  ///< of a deployment
  std::string text;  ///< with how to mend it
};

struct Plan {
  std::vector<Step> steps;  ///< by gateway, on each in the order of StepKind
  std::vector<Problem> problems;
  std::vector<Step> kept;              ///< would be undeployed, if that were wanted
  std::vector<std::string> passed_by;  ///< gateways that drain, and therefore get nothing of what is for all
  std::size_t same = 0;                ///< instances that are as they are to be
  std::set<std::string> not_compared;  ///< keys of hidden properties, which are taken for what is wanted
};

struct PlanOptions {
  bool prune = true;   ///< what the manifest deployed and does not name any more goes
  bool adopt = false;  ///< instances of the manifest's names that others deployed belong to it from now on
};

/// What makes the fleet as the manifest says, and nothing else. An instance that the manifest did not deploy is never
/// touched, unless it has a name of the manifest's and may be adopted.
Plan make_plan(const Manifest& manifest, const Fleet& fleet, const PlanOptions& options);

}  // namespace iotcloud::master::cli
