#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/config/declaration.h>
#include <iotcloud/master/cli/fleet/manifest.h>

/// Checks properties against what plugins declare, before anything is ordered.
namespace iotcloud::master::cli {

/// A plugin's declaration.
struct DeclaredPlugin {
  std::string where;  ///< for messages: "./station.so", "station.so on lab1"
  config::DriverDeclaration declaration;
};
/// The declarations of a deployment's plugin: they may differ from gateway to gateway.
using FindDeclarations = std::function<std::vector<DeclaredPlugin>(const ManifestDeployment&)>;

/// Finds what is wrong with the properties of one instance, each problem once. \return a line for each: empty, nothing
std::vector<config::PropertyProblem> property_problems(const config::Properties& properties,
                                                       const std::vector<DeclaredPlugin>& plugins);

/// Checks all deployments of a manifest. \throws config::ConfigError that says all that is wrong, a line for each with
/// its place in the file
void check_properties(const Manifest& manifest, const FindDeclarations& find);

}  // namespace iotcloud::master::cli
