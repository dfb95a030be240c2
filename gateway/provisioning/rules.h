#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/gateway/provisioning/template.h>

namespace iotcloud::gateway {

/// An instance that looks for devices, and reports what it finds.
struct FinderRule {
  std::string name;    ///< also of its instance
  std::string plugin;  ///< file in the gateway's plugin folder
  std::map<std::string, std::string> properties;
};

/// What to run for each thing that a finder finds.
struct DeployRule {
  std::string name;            ///< of the rule
  std::string finder;          ///< FinderRule::name
  discovery::Selection where;  ///< of what is found: its attributes are the metadata of the selected
  std::string plugin;          ///< file in the gateway's plugin folder
  std::string driver;          ///< empty: the plugin's own
  Template instance;           ///< the name of the instance
  std::map<std::string, Template> properties;
  std::map<std::string, Template> metadata;
  std::chrono::milliseconds grace{60'000};  ///< how long an instance stays when what it is for is gone
  std::size_t most = 100;                   ///< instances of this rule
  double rate = 20;                         ///< most of them that are made, or made anew, in a second
};

/// A gateway's rules that provision (README.md).
struct ProvisioningRules {
  std::vector<FinderRule> finders;
  std::vector<DeployRule> rules;  ///< of several that select a thing the first counts

  /// \throws config::ConfigError with file, line, key and remedy
  static ProvisioningRules load(const std::string& file);
  /// \param name stands for the file in messages
  static ProvisioningRules parse(std::string_view text, const std::string& name);
};

}  // namespace iotcloud::gateway
