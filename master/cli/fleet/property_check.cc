#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/yaml/errors.h>
#include <iotcloud/master/cli/fleet/property_check.h>
#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master::cli {

std::vector<config::PropertyProblem> property_problems(const config::Properties& properties,
                                                       const std::vector<DeclaredPlugin>& plugins) {
  std::vector<config::PropertyProblem> all;
  for (const auto& plugin : plugins) {
    for (auto& problem : config::problems_of(properties, plugin.declaration)) {
      const auto value = properties.find(problem.property);
      // An error message may end up in a log.
      if (value != properties.end() && !value->second.empty() && is_secret(problem.property, value->second)) {
        if (const auto at = problem.text.find(value->second); at != std::string::npos)
          problem.text.replace(at, value->second.size(), "***");
      }
      problem.text += fmt::format(" ({})", plugin.where);
      if (std::find(all.begin(), all.end(), problem) == all.end()) all.push_back(std::move(problem));
    }
  }
  return all;
}

void check_properties(const Manifest& manifest, const FindDeclarations& find) {
  std::vector<config::ConfigError> errors;
  for (const auto& deployment : manifest.deployments) {
    const auto plugins = find(deployment);
    std::set<std::pair<std::string, std::string>> told;
    for (int index = 1; index <= std::max(1, deployment.count) && !plugins.empty(); ++index) {
      if (index > 1 && deployment.own.empty()) break;  // all are alike
      for (auto& problem : property_problems(deployment.properties_of(index), plugins)) {
        if (!told.emplace(problem.property, problem.text).second) continue;
        errors.emplace_back(deployment.place_of(problem.property, index),
                            fmt::format("deployments.{}.properties.{}", deployment.name, problem.property),
                            problem.text, "");
      }
    }
  }
  if (!errors.empty()) throw config::together(errors);
}

}  // namespace iotcloud::master::cli
