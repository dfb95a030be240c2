// A fleet's manifest, as anybody may write it, and what it would change.
#include <string>

#include "iotcloud/config/error.h"
#include "iotcloud/master/cli/fleet/manifest.h"
#include "iotcloud/master/cli/fleet/plan.h"
#include "iotcloud/tests/fuzz/bytes.h"

using namespace iotcloud;
using namespace iotcloud::master::cli;

namespace {

/// The fleet after a plan that only deploys was carried out.
Fleet carried_out(const Manifest& manifest, const Plan& plan, Fleet fleet) {
  for (const auto& step : plan.steps) {
    fuzz::must(step.kind == StepKind::deploy, "in an empty fleet there is nothing else to do");
    const auto& wanted = manifest.deployments.at(step.deployment);
    fleet.instances.push_back({step.gateway, "id", step.name, step.index, manifest.fleet, wanted.driver, wanted.plugin,
                               wanted.active, wanted.properties, wanted.metadata, ""});
  }
  return fleet;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Manifest manifest;
  try {
    manifest = read_manifest(config::Section::parse(fuzz::text(data, size), "fleet.yaml"));
  } catch (const config::ConfigError& error) {
    fuzz::must(std::string(error.what()).starts_with("fleet.yaml"), "an error names the file");
    return 0;
  }
  std::size_t instances = 0;
  for (const auto& deployment : manifest.deployments) instances += static_cast<std::size_t>(deployment.count);
  if (instances > 1'000) return 0;
  Fleet fleet;
  fleet.gateways = {{"lab1", false, false}, {"lab2", true, false}, {"java", false, true}};
  const auto first = make_plan(manifest, fleet, {});
  const auto second = make_plan(manifest, carried_out(manifest, first, fleet), {});
  fuzz::must(second.steps.empty() && second.same == first.steps.size(), "applied twice it changes nothing");
  return 0;
}
