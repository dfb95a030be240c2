#include <algorithm>
#include <ostream>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/cli/fleet/plugin_declarations.h>
#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

void PluginDeclarations::ask() {
  known_.emplace();
  if (master_.status().registry_away) return;  // the order that follows says so, and needs no time-out for it
  std::vector<discovery::GatewayId> living;
  for (const auto& gateway : master_.gateways()) {
    if (gateway.alive && !gateway.original) living.push_back(gateway.record.id);
  }
  if (living.empty()) return;
  try {
    auto answer = master_.plugins(living);
    known_ = std::move(answer.plugins);
    silent_ = std::move(answer.silent);
  } catch (const RequestFailed& e) {  // an older master, or one without the registry
    for (const auto& gateway : living) silent_[gateway] = e.what();
  }
}

std::vector<DeclaredPlugin> PluginDeclarations::of(const std::string& plugin,
                                                   const std::vector<discovery::GatewayId>& gateways) {
  if (!known_) ask();
  struct Group {
    config::DriverDeclaration declaration;
    std::vector<discovery::GatewayId> gateways;
  };
  std::map<std::string, Group> groups;  // by declaration
  for (const auto& [gateway, known] : *known_) {
    const bool wanted = gateways.empty() || std::find(gateways.begin(), gateways.end(), gateway) != gateways.end();
    if (known.sent || known.file != plugin || !wanted) continue;
    auto& group = groups[known.declaration];
    if (group.gateways.empty()) group.declaration = config::parse_declaration(known.declaration);
    group.gateways.push_back(gateway);
  }
  std::vector<DeclaredPlugin> plugins;
  for (auto& [text, group] : groups) {
    const std::string where =
        groups.size() == 1 ? plugin : fmt::format("{} on {}", plugin, fmt::join(group.gateways, ", "));
    plugins.push_back({where, std::move(group.declaration)});
  }
  return plugins;
}

std::vector<DeclaredPlugin> PluginDeclarations::sent(const std::string& sha256) {
  if (!known_) ask();
  for (const auto& [gateway, known] : *known_) {
    if (known.sent && known.sha256 == sha256) return {{known.file, config::parse_declaration(known.declaration)}};
  }
  return {};
}

void tell_unchecked(const PluginDeclarations& declarations, std::ostream& err) {
  for (const auto& [gateway, why] : declarations.silent())
    err << fmt::format("iotcloud: properties for {} are checked only there: {}\n", printable(gateway), printable(why));
}

std::string lines_of(const std::vector<config::PropertyProblem>& problems) {
  std::string text;
  for (const auto& problem : problems)
    text += fmt::format("{}property \"{}\": {}", text.empty() ? "" : "\n  ", problem.property, problem.text);
  return text;
}

}  // namespace iotcloud::master::cli
