#include <algorithm>
#include <filesystem>
#include <set>

#include <fmt/format.h>

#include <iotcloud/master/cli/fleet/channel_options.h>
#include <iotcloud/master/cli/fleet/manifest.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

using config::Section;

/// Names become parts of paths in the registry and of topics.
bool is_name(const std::string& text) {
  constexpr std::size_t longest = 200;
  return !text.empty() && text.size() <= longest && text != "." && text != ".." &&
         std::none_of(text.begin(), text.end(), [](unsigned char c) { return c == '/' || c < 0x20 || c == 0x7f; });
}

std::string checked_name(Section& section, const std::string& key, const std::string& text) {
  if (is_name(text)) return text;
  throw section.error(key, fmt::format("\"{}\" cannot be a name", text),
                      "1 to 200 characters, no slash and no control character");
}

/// Reads and checks the plugin of a deployment; nothing else decides which plugins a manifest may name.
void read_plugin(Section& section, const FindPlugin& find_plugin, Deployment& deployment) {
  const auto plugin = section.require_string("plugin");
  deployment.plugin = plugin;
  if (find_plugin && is_local_plugin(plugin)) {
    try {
      auto found = find_plugin(plugin);
      deployment.plugin = std::filesystem::path(plugin).filename();
      deployment.file = std::move(found.path);
      deployment.sha256 = std::move(found.sha256);
    } catch (const std::exception& e) {
      throw section.error("plugin", e.what(), "");
    }
  }
  if (is_name(deployment.plugin)) return;
  throw section.error(
      "plugin", fmt::format("\"{}\" is no plugin", plugin),
      "the name of a file in the gateways' plugin folder, such as turtle.so; or a file of this machine, "
      "such as ./turtle.so, which is sent");
}

void read_gateways(Section& section, Deployment& deployment) {
  const std::string all = "all";
  auto gateways = section.require_strings("gateways");
  if (gateways == std::vector<std::string>{all}) {
    deployment.all_gateways = true;
    return;
  }
  std::set<std::string> seen;
  for (const auto& id : gateways) {
    if (id == all) throw section.error("gateways", "\"all\" stands beside others", "all, or a list of gateways' ids");
    checked_name(section, "gateways", id);
    if (!seen.insert(id).second) throw section.error("gateways", fmt::format("{} stands here twice", id), "");
  }
  deployment.gateways = {gateways.begin(), gateways.end()};
}

/// Reads a YAML mapping of any keys to texts. \param may_be_empty whether the texts may be empty.
std::map<std::string, std::string> read_texts(Section& section, const std::string& key, bool may_be_empty) {
  std::map<std::string, std::string> texts;
  auto mapping = section.optional_section(key);
  if (!mapping) return texts;
  for (const auto& name : mapping->names()) {
    if (name.empty()) throw mapping->error(name, "a key has at least one character", "");
    texts[name] = may_be_empty ? mapping->string_or(name, "") : mapping->require_string(name);
  }
  return texts;
}

void read_properties(Section& section, Deployment& deployment) {
  deployment.properties = read_texts(section, "properties", true);
  for (const auto& [name, value] : deployment.properties) {
    if (!name.starts_with("channel.")) continue;
    throw section.require_section("properties")
        .error(name, "this is of a channel", "say it under \"channels\": {data: {deadline_ms: 100}}");
  }
}

void read_channels(Section& section, Deployment& deployment) {
  for (auto& [channel, options] : section.sections("channels")) {
    checked_name(section, "channels", channel);
    for (const auto& option : options.names()) {
      const auto value = options.string_or(option, "");
      if (auto problem = channel_option_problem(option, value); !problem.empty())
        throw options.error(option, problem, "");
      deployment.properties[channel_property(channel, option)] = value;
    }
    const auto when_full = options.string_or("when_full", "");
    for (const auto& option : options.names()) {
      if (auto problem = spool_option_problem(option, when_full); !problem.empty())
        throw options.error(option, problem, "");
    }
  }
}

Deployment read_deployment(const std::string& name, Section& section, const FindPlugin& find_plugin) {
  Deployment deployment;
  deployment.name = checked_name(section, "", name);
  read_plugin(section, find_plugin, deployment);
  if (const auto driver = section.optional_string("driver"))
    deployment.driver = discovery::DriverName(checked_name(section, "driver", *driver));
  read_gateways(section, deployment);
  deployment.count = static_cast<int>(section.int_or("count", 1, 0, most_instances));
  deployment.active = section.choice_or("state", "active", {"active", "inactive"}) == "active";
  read_properties(section, deployment);
  read_channels(section, deployment);
  deployment.metadata = read_texts(section, "metadata", false);
  section.finish();
  return deployment;
}

}  // namespace

Manifest read_manifest(config::Section top, const FindPlugin& find_plugin) {
  Manifest manifest;
  manifest.fleet = checked_name(top, "fleet", top.require_string("fleet"));
  if (!top.has("deployments"))
    throw top.error("", "the key \"deployments\" is missing",
                    "add \"deployments:\"; {} takes everything away that this manifest deployed");
  for (auto& [name, section] : top.sections("deployments"))
    manifest.deployments.push_back(read_deployment(name, section, find_plugin));
  top.finish();
  return manifest;
}

Manifest load_manifest(const std::string& file) {
  const auto folder = std::filesystem::path(file).parent_path();
  return read_manifest(config::Section::load_file(file), [&](const std::string& named) {
    const std::string path = folder / named;
    return PluginFile{path, security::sha256_hex(plugin_bytes(path))};
  });
}

}  // namespace iotcloud::master::cli
