// A fleet's manifest, as anybody may write it, and the plan that follows from it.
#include <string>

#include "iotcloud/config/error.h"
#include "iotcloud/master/cli/fleet/manifest.h"
#include "iotcloud/master/cli/fleet/plan.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include <iotcloud/tests/discovery/id_literals.h>

using namespace iotcloud;
namespace cli = master::cli;

namespace {

/// The fleet after carrying out a plan that only deploys.
cli::Fleet carried_out(const cli::Manifest& manifest, const cli::FleetPlan& plan, cli::Fleet fleet) {
  for (const auto& step : plan.steps) {
    fuzz::must(step.kind == cli::FleetStepKind::deploy, "in an empty fleet there is nothing else to do");
    const auto& wanted = manifest.deployments.at(step.deployment);
    auto& instance = fleet.instances.emplace_back();
    static_cast<discovery::Deployment&>(instance) = wanted;
    instance.gateway = step.gateway;
    instance.instance = "id"_instance;
    instance.name = step.name;
    instance.index = step.index;
    instance.manager = manifest.fleet;
  }
  return fleet;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(manifest, 5'000) {
  cli::Manifest manifest;
  try {
    manifest = cli::read_manifest(config::YamlSection::parse(fuzz::text(data, size), "fleet.yaml"));
  } catch (const config::ConfigError& error) {
    fuzz::must(std::string(error.what()).starts_with("fleet.yaml"), "an error names the file");
    return;
  }
  std::size_t instances = 0;
  for (const auto& deployment : manifest.deployments) instances += static_cast<std::size_t>(deployment.count);
  if (instances > 1'000) return;
  cli::Fleet fleet;
  fleet.gateways = {{"lab1"_gateway, false, false}, {"lab2"_gateway, true, false}, {"java"_gateway, false, true}};
  const auto first = cli::make_plan(manifest, fleet, {});
  const auto second = cli::make_plan(manifest, carried_out(manifest, first, fleet), {});
  fuzz::must(second.steps.empty() && second.same == first.steps.size(), "applied twice it changes nothing");
}
