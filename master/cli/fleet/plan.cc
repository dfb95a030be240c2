#include <algorithm>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/cli/fleet/plan.h>
#include <iotcloud/master/listing/secret_properties.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

using discovery::DriverName;
using discovery::GatewayId;
using discovery::InstanceId;
using Key = std::tuple<GatewayId, std::string, int>;  ///< gateway, name, index

constexpr const char* hidden = "***";

/// Lists the differences, each key once: "rate: 5 -> 10", "site: - -> lab".
std::vector<std::string> differences(const Texts& from, const Texts& to) {
  const auto shown = [](const Texts& texts, const std::string& key) -> std::string {
    const auto found = texts.find(key);
    if (found == texts.end()) return "-";
    if (is_secret(key, found->second)) return hidden;
    return found->second.empty() ? "\"\"" : found->second;
  };
  std::vector<std::string> lines;
  std::set<std::string> keys;
  for (const auto* texts : {&from, &to}) {
    for (const auto& [key, value] : *texts) keys.insert(key);
  }
  for (const auto& key : keys) {
    const auto a = from.find(key);
    const auto b = to.find(key);
    if (a != from.end() && b != to.end() && a->second == b->second) continue;
    lines.push_back(fmt::format("{}: {} -> {}", key, shown(from, key), shown(to, key)));
  }
  return lines;
}

Texts changes(const Texts& from, const Texts& to) {
  Texts out;
  for (const auto& [key, value] : from) {
    if (!to.contains(key)) out[key] = "";
  }
  for (const auto& [key, value] : to) {
    const auto found = from.find(key);
    if (found == from.end() || found->second != value) out[key] = value;
  }
  return out;
}

/// The plugin's name for people, with a short hash, because files of equal name may differ.
std::string version(const std::string& plugin, const std::string& sha256) {
  return sha256.empty() ? plugin : fmt::format("{} ({})", plugin, security::short_sha256(sha256));
}

std::string or_own(const DriverName& driver) {
  return driver.empty() ? "the plugin's own" : driver.str();
}

class Planner {
 public:
  Planner(const Manifest& manifest, const Fleet& fleet, const FleetPlanOptions& options)
      : manifest_(manifest), fleet_(fleet), options_(options) {
    for (const auto& instance : fleet.instances) {
      if (!instance.name.empty()) there_[{instance.gateway, instance.name, instance.index}] = &instance;
    }
  }

  FleetPlan plan() {
    for (std::size_t i = 0; i < manifest_.deployments.size(); ++i) place(i);
    prune();
    const auto order = [](const FleetStep& step) { return std::tie(step.gateway, step.kind, step.name, step.index); };
    const auto before = [&](const FleetStep& a, const FleetStep& b) { return order(a) < order(b); };
    std::sort(plan_.steps.begin(), plan_.steps.end(), before);
    std::sort(plan_.kept.begin(), plan_.kept.end(), before);
    plan_.passed_by.assign(passed_by_.begin(), passed_by_.end());
    return std::move(plan_);
  }

 private:
  void place(std::size_t number) {
    const auto& deployment = manifest_.deployments[number];
    if (deployment.all_gateways) {
      for (const auto& gateway : fleet_.gateways) {
        if (!gateway.original) place_on(number, gateway);
      }
      return;
    }
    for (const auto& id : deployment.gateways) {
      const auto gateway =
          std::find_if(fleet_.gateways.begin(), fleet_.gateways.end(), [&](const auto& g) { return g.id == id; });
      if (gateway == fleet_.gateways.end()) {
        complain(id, deployment, unknown_gateway_text());
      } else if (gateway->original) {
        complain(id, deployment, "the gateway is of the original system, which knows no names: use iotcloud deploy");
      } else {
        place_on(number, *gateway);
      }
    }
  }

  std::string unknown_gateway_text() const {
    std::vector<GatewayId> ids;
    for (const auto& gateway : fleet_.gateways) ids.push_back(gateway.id);
    return ids.empty() ? "no gateway is registered: start iotcloud-gateway"
                       : fmt::format("there is no such gateway; there are {}", fmt::join(ids, ", "));
  }

  void place_on(std::size_t number, const Fleet::Gateway& gateway) {
    const auto& deployment = manifest_.deployments[number];
    bool complained = false;
    for (int index = 1; index <= deployment.count; ++index) {
      const Key key{gateway.id, deployment.name, index};
      wanted_.insert(key);
      const auto found = there_.find(key);
      if (found != there_.end()) {
        compare(number, *found->second, gateway);
      } else if (!gateway.draining) {
        add(FleetStepKind::deploy, number, gateway.id, index, {});
      } else if (deployment.all_gateways) {
        passed_by_.insert(gateway.id);
      } else if (!std::exchange(complained, true)) {
        complain(gateway.id, deployment, drains_text(gateway.id));
      }
    }
  }

  static std::string drains_text(const GatewayId& gateway) {
    return fmt::format("the gateway is draining, so nothing is deployed on it; `iotcloud undrain {}` ends that",
                       gateway);
  }

  static constexpr const char* lost_text =
      "the gateway is lost, so nobody could see whether it comes up with the other plugin; apply again when it is back";

  void compare(std::size_t number, const Fleet::Instance& there, const Fleet::Gateway& gateway) {
    const auto& wanted = manifest_.deployments[number];
    if (there.ordered) ++plan_.ordered;
    const auto to_do = [&](FleetStepKind kind) -> FleetStep& {
      return add(kind, number, there.gateway, there.index, there.instance);
    };
    if (there.manager != manifest_.fleet) {
      const auto whose = there.manager.empty() ? std::string("a person deployed it")
                                               : fmt::format("it belongs to the manifest \"{}\"", there.manager);
      if (!options_.adopt) {
        complain(there.gateway, wanted,
                 fmt::format("{}/{} is not this manifest's: {}; --adopt takes it over, another name leaves it alone",
                             there.name, there.index, whose));
        return;
      }
      to_do(FleetStepKind::adopt).what = {whose};
    }
    const bool other_plugin = there.plugin != wanted.plugin || there.sha256 != wanted.sha256;
    // Without a driver in the manifest the instance keeps the name that the first plugin gave it, because topics
    // contain it.
    const bool other_driver = !wanted.driver.empty() && there.driver != wanted.driver;
    if ((other_plugin || other_driver) && gateway.draining) {
      complain(gateway.id, wanted, drains_text(gateway.id));
      return;
    }
    const auto plugins =
        fmt::format("plugin: {} -> {}", version(there.plugin, there.sha256), version(wanted.plugin, wanted.sha256));
    if (other_driver) {
      auto& step = to_do(FleetStepKind::replace);
      if (other_plugin) step.what.push_back(plugins);
      step.what.push_back(fmt::format("driver: {} -> {}", or_own(there.driver), wanted.driver));
      return;
    }
    if (other_plugin && gateway.lost) {
      complain(gateway.id, wanted, lost_text);
      return;
    }
    const std::size_t before = plan_.steps.size();
    if (other_plugin) to_do(FleetStepKind::update).what = {plugins};
    const Texts wanted_properties = wanted.properties_of(there.index);
    const Texts properties = known_properties(there, wanted_properties);
    const bool anew = properties != wanted_properties;
    if (anew) {
      auto& step = to_do(FleetStepKind::change);
      step.what = differences(properties, wanted_properties);
      step.recorded_only = gateway.lost;
    }
    if (there.metadata != wanted.metadata) {
      auto& step = to_do(FleetStepKind::describe);
      step.what = differences(there.metadata, wanted.metadata);
      step.metadata = changes(there.metadata, wanted.metadata);
    }
    if (there.active != wanted.active) {
      to_do(wanted.active ? FleetStepKind::start : FleetStepKind::stop);
    } else if (wanted.active && !there.failure.empty() && !gateway.draining && !anew && !other_plugin) {
      to_do(FleetStepKind::start).what = {"it failed: " + there.failure};
    }
    if (plan_.steps.size() == before) ++plan_.same;
  }

  /// The instance's properties. A hidden value is assumed to be the wanted one.
  Texts known_properties(const Fleet::Instance& there, const Texts& wanted) {
    Texts known = there.properties;
    for (const auto& key : there.hidden) {
      const auto found = wanted.find(key);
      known[key] = found == wanted.end() ? hidden : found->second;
      plan_.not_compared.insert(key);
    }
    return known;
  }

  void prune() {
    for (const auto& there : fleet_.instances) {
      if (there.manager != manifest_.fleet || wanted_.contains({there.gateway, there.name, there.index})) continue;
      FleetStep step;
      step.kind = FleetStepKind::undeploy;
      step.gateway = there.gateway;
      step.name = there.name;
      step.index = there.index;
      step.instance = there.instance;
      (options_.prune ? plan_.steps : plan_.kept).push_back(std::move(step));
    }
  }

  FleetStep& add(FleetStepKind kind, std::size_t number, const GatewayId& gateway, int index,
                 const InstanceId& instance) {
    auto& step = plan_.steps.emplace_back();
    step.kind = kind;
    step.gateway = gateway;
    step.name = manifest_.deployments[number].name;
    step.index = index;
    step.instance = instance;
    step.deployment = number;
    return step;
  }

  void complain(const GatewayId& gateway, const ManifestDeployment& deployment, std::string text) {
    plan_.problems.push_back({gateway, deployment.name, std::move(text)});
  }

  const Manifest& manifest_;
  const Fleet& fleet_;
  const FleetPlanOptions& options_;
  std::map<Key, const Fleet::Instance*> there_;
  std::set<Key> wanted_;
  std::set<GatewayId> passed_by_;
  FleetPlan plan_;
};

}  // namespace

std::string to_string(FleetStepKind kind) {
  switch (kind) {
    case FleetStepKind::undeploy:
      return "undeploy";
    case FleetStepKind::stop:
      return "stop";
    case FleetStepKind::adopt:
      return "adopt";
    case FleetStepKind::replace:
      return "replace";
    case FleetStepKind::update:
      return "update";
    case FleetStepKind::change:
      return "change";
    case FleetStepKind::describe:
      return "describe";
    case FleetStepKind::start:
      return "start";
    case FleetStepKind::deploy:
      return "deploy";
  }
  return "";
}

FleetPlan make_plan(const Manifest& manifest, const Fleet& fleet, const FleetPlanOptions& options) {
  return Planner(manifest, fleet, options).plan();
}

}  // namespace iotcloud::master::cli
