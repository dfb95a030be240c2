#include <algorithm>
#include <array>

#include <fmt/format.h>

#include <iotcloud/config/yaml.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/provisioning/rules.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

namespace {

/// Whether the host or the gateway itself obeys the property (gateway/README.md).
bool is_obeyed_by_host(const std::string& property) {
  constexpr std::array obeyed{"isolation", "thread", "hang_limit", "on_partition", "lease", "network"};
  return property.starts_with("channel.") || std::find(obeyed.begin(), obeyed.end(), property) != obeyed.end();
}

Template read_template(config::YamlSection& section, const std::string& key, const std::string& text) {
  Template read;
  section.check(key, [&] { read = Template::parse(text); });
  return read;
}

std::map<std::string, Template> read_templates(config::YamlSection& section, const std::string& key) {
  std::map<std::string, Template> templates;
  for (const auto& [name, text] : section.string_map(key)) {
    Template read = read_template(section, key, text);
    if (key == "properties" && read.has_places() && is_obeyed_by_host(name)) {
      section.refuse(key, fmt::format("\"{}\" takes an attribute of what is found, and the driver host obeys it", name),
                     "write its value out");
    }
    templates.emplace(name, std::move(read));
  }
  return templates;
}

std::string read_plugin(config::YamlSection& section) {
  const std::string plugin = section.require_string("plugin");
  section.check("plugin", [&] { check_plugin_file_name(plugin); });
  return plugin;
}

FinderRule read_finder(const std::string& name, config::YamlSection& section) {
  FinderRule finder;
  finder.name = name;
  finder.plugin = read_plugin(section);
  finder.properties = section.string_map("properties");
  section.finish();
  return finder;
}

DeployRule read_rule(const std::string& name, config::YamlSection& section, const std::vector<FinderRule>& finders) {
  DeployRule rule;
  rule.name = name;
  rule.finder = section.require_string("finder");
  const auto known = [&](const FinderRule& finder) { return finder.name == rule.finder; };
  if (std::none_of(finders.begin(), finders.end(), known))
    section.refuse("finder", fmt::format("there is no finder \"{}\"", rule.finder), "name one of those above");
  if (const auto where = section.optional_string("where"))
    section.check("where", [&] { rule.where = discovery::Selection::parse(*where); });
  rule.plugin = read_plugin(section);
  rule.driver = section.string_or("driver", "");
  if (!rule.driver.empty()) section.check("driver", [&] { check_name("driver name", rule.driver); });
  rule.instance = read_template(section, "name", section.require_string("name"));
  if (!rule.instance.has_places()) {
    section.refuse("name", "it is the same for everything that is found",
                   "put an attribute into it, such as {id:name}");
  }
  rule.properties = read_templates(section, "properties");
  rule.metadata = read_templates(section, "metadata");
  const auto grace = section.duration_or("grace", std::chrono::microseconds(rule.grace));
  if (grace < std::chrono::microseconds{0}) section.refuse("grace", "it is negative", "give a time such as 60s");
  rule.grace = std::chrono::duration_cast<milliseconds>(grace);
  constexpr std::int64_t most_instances = 10'000;
  rule.most = static_cast<std::size_t>(section.int_or("most", static_cast<std::int64_t>(rule.most), 1, most_instances));
  constexpr double slowest = 0.01, fastest = 10'000;
  rule.rate = section.double_or("rate", rule.rate, slowest, fastest);
  section.finish();
  return rule;
}

ProvisioningRules read_rules(config::YamlSection& file) {
  ProvisioningRules read;
  const auto check_named = [&](const char* key, const std::string& name) {
    file.check(key, [&] { check_name(key, name); });
  };
  for (auto& [name, section] : file.sections("finders")) {
    check_named("finders", name);
    read.finders.push_back(read_finder(name, section));
  }
  for (auto& [name, section] : file.sections("rules")) {
    check_named("rules", name);
    read.rules.push_back(read_rule(name, section, read.finders));
  }
  file.finish();
  return read;
}

}  // namespace

ProvisioningRules ProvisioningRules::load(const std::string& path) {
  ProvisioningRules rules;
  config::YamlSection::read_file(path, [&](config::YamlSection& file) { rules = read_rules(file); });
  return rules;
}

ProvisioningRules ProvisioningRules::parse(std::string_view text, const std::string& name) {
  ProvisioningRules rules;
  config::YamlSection::read_text(text, name, [&](config::YamlSection& file) { rules = read_rules(file); });
  return rules;
}

}  // namespace iotcloud::gateway
