#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

#include <fmt/format.h>

#include <iotcloud/master/cli/fleet/channel_options.h>
#include <iotcloud/master/cli/fleet/manifest.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

using config::YamlSection;

/// Names become parts of paths in the registry and of topics.
bool is_name(const std::string& text) {
  constexpr std::size_t longest = 200;
  return !text.empty() && text.size() <= longest && text != "." && text != ".." &&
         std::none_of(text.begin(), text.end(), [](unsigned char c) { return c == '/' || c < 0x20 || c == 0x7f; });
}

std::string checked_name(YamlSection& section, const std::string& key, const std::string& text) {
  if (!is_name(text)) {
    section.refuse(key, fmt::format("\"{}\" cannot be a name", text),
                   "1 to 200 characters, no slash and no control character");
  }
  return text;
}

std::string text_of_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::string text(std::istreambuf_iterator<char>(in), {});
  if (!in || std::filesystem::is_directory(path))
    throw std::invalid_argument(fmt::format("{} cannot be read: {}", path, std::strerror(errno)));
  return text;
}

/// Reads and checks the plugin of a deployment; nothing else decides which plugins a manifest may name.
void read_plugin(YamlSection& section, const FindPlugin& find_plugin, ManifestDeployment& deployment) {
  const auto plugin = section.require_string("plugin");
  deployment.plugin = plugin;
  if (find_plugin && is_local_plugin(plugin)) {
    try {
      auto found = find_plugin(plugin);
      deployment.plugin = std::filesystem::path(plugin).filename();
      deployment.file = std::move(found.path);
      deployment.sha256 = std::move(found.sha256);
      deployment.declared = {std::move(found.declaration)};
    } catch (const std::exception& e) {
      section.refuse("plugin", e.what());
      return;
    }
  }
  if (is_name(deployment.plugin)) return;
  section.refuse("plugin", fmt::format("\"{}\" is no plugin", plugin),
                 "the name of a file in the gateways' plugin folder, such as turtle.so; or a file of this machine, "
                 "such as ./turtle.so, which is sent");
}

void read_gateways(YamlSection& section, ManifestDeployment& deployment) {
  const std::string all = "all";
  auto gateways = section.require_strings("gateways");
  if (gateways == std::vector<std::string>{all}) {
    deployment.all_gateways = true;
    return;
  }
  std::set<std::string> seen;
  for (const auto& id : gateways) {
    if (id == all) section.refuse("gateways", "\"all\" stands beside others", "all, or a list of gateways' ids");
    checked_name(section, "gateways", id);
    if (!seen.insert(id).second) section.refuse("gateways", fmt::format("{} stands here twice", id), "");
  }
  deployment.gateways = {gateways.begin(), gateways.end()};
}

/// Reads a YAML mapping of any keys to texts.
Texts read_texts(YamlSection& section, const std::string& key) {
  Texts texts;
  auto mapping = section.optional_section(key);
  if (!mapping) return texts;
  for (const auto& name : mapping->names()) {
    if (name.empty()) mapping->refuse(name, "a key has at least one character", "");
    texts[name] = mapping->require_string(name);
  }
  return texts;
}

void read_properties(YamlSection& section, ManifestDeployment& deployment) {
  deployment.places[""] = section.where();
  auto mapping = section.optional_section("properties");
  if (!mapping) return;
  for (const auto& name : mapping->names()) {
    if (name.empty()) mapping->refuse(name, "a key has at least one character", "");
    if (name.starts_with("channel.")) {
      mapping->refuse(name, "this is of a channel", "say it under \"channels\": {data: {deadline_ms: 100}}");
    }
    deployment.places[name] = mapping->where(name);
    if (!mapping->is_list(name)) {
      deployment.properties[name] = mapping->string_or(name, "");
      continue;
    }
    const auto values = mapping->require_strings(name);
    if (values.size() != static_cast<std::size_t>(deployment.count)) {
      mapping->refuse(
          name, fmt::format("a list of {} values for {} instances on each gateway", values.size(), deployment.count),
          "one value for each instance, or one for all without brackets");
      continue;
    }
    for (int index = 1; index <= deployment.count; ++index)
      deployment.own[index][name] = values[static_cast<std::size_t>(index - 1)];
  }
}

/// Reads the file that says what each instance has of its own.
void read_each(YamlSection& section, const ReadFile& read_file, ManifestDeployment& deployment) {
  const auto file = section.optional_string("each");
  if (!file) return;
  if (!read_file) {
    section.refuse("each", "this manifest may name no file", "");
    return;
  }
  std::vector<Texts> instances;
  try {
    instances = read_csv(read_file(*file), *file);
  } catch (const std::exception& e) {
    section.refuse("each", e.what(), "");
    return;
  }
  if (section.has("count") && deployment.count != static_cast<int>(instances.size()))
    section.refuse("count",
                   fmt::format("{} has {} instances, count says {}", *file, instances.size(), deployment.count),
                   "leave count out");
  if (instances.size() > static_cast<std::size_t>(most_instances)) {
    section.refuse("each", fmt::format("{} has more than {} instances", *file, most_instances), "");
    return;
  }
  deployment.count = static_cast<int>(instances.size());
  deployment.each_file = *file;
  for (int index = 1; index <= deployment.count; ++index) {
    for (auto& [name, value] : instances[static_cast<std::size_t>(index - 1)]) {
      if (name.starts_with("channel."))
        section.refuse("each", fmt::format("{} has the column {}, which is of a channel", *file, name),
                       "say it under \"channels\"");
      deployment.own[index][name] = std::move(value);
    }
  }
}

/// Puts the numbers of instances into the properties that ask for them.
void read_index_marks(ManifestDeployment& deployment) {
  for (int index = 1; index <= deployment.count; ++index) {
    auto with_numbers = config::numbered(deployment.properties, index);
    if (const auto own = deployment.own.find(index); own != deployment.own.end()) {
      own->second.merge(config::numbered(deployment.properties, index));  // what is its own goes before
      for (auto& [name, value] : config::numbered(own->second, index)) own->second[name] = value;
    } else if (!with_numbers.empty()) {
      deployment.own[index] = std::move(with_numbers);
    }
  }
}

void read_channels(YamlSection& section, ManifestDeployment& deployment) {
  for (auto& [channel, options] : section.sections("channels")) {
    checked_name(section, "channels", channel);
    for (const auto& option : options.names()) {
      const auto value = options.string_or(option, "");
      if (auto problem = channel_option_problem(option, value); !problem.empty()) options.refuse(option, problem, "");
      deployment.properties[channel_property(channel, option)] = value;
    }
    const auto when_full = options.string_or("when_full", "");
    for (const auto& option : options.names()) {
      if (auto problem = spool_option_problem(option, when_full); !problem.empty()) options.refuse(option, problem, "");
    }
  }
}

ManifestDeployment read_deployment(const std::string& name, YamlSection& section, const FindPlugin& find_plugin,
                                   const ReadFile& read_file) {
  ManifestDeployment deployment;
  deployment.name = checked_name(section, "", name);
  read_plugin(section, find_plugin, deployment);
  if (const auto driver = section.optional_string("driver"))
    deployment.driver = discovery::DriverName(checked_name(section, "driver", *driver));
  read_gateways(section, deployment);
  deployment.count = static_cast<int>(section.int_or("count", 1, 0, most_instances));
  deployment.active = section.choice_or("state", "active", {"active", "inactive"}) == "active";
  read_each(section, read_file, deployment);
  read_properties(section, deployment);
  read_index_marks(deployment);
  read_channels(section, deployment);
  deployment.metadata = read_texts(section, "metadata");
  section.finish();
  return deployment;
}

ManifestTopology read_topology(const std::string& name, YamlSection& section) {
  ManifestTopology topology;
  topology.name = discovery::TopologyName(checked_name(section, "", name));
  topology.file = section.require_string("file");
  topology.workers = static_cast<int>(section.int_or("workers", 1, 1, most_topology_workers));
  topology.place = section.where();
  section.finish();
  return topology;
}

}  // namespace

Texts ManifestDeployment::properties_of(int index) const {
  const auto found = own.find(index);
  if (found == own.end()) return properties;
  Texts all = found->second;
  all.insert(properties.begin(), properties.end());  // its own go before
  return all;
}

config::Location ManifestDeployment::place_of(const std::string& property, int index) const {
  if (const auto found = places.find(property); found != places.end()) return found->second;
  const auto its = own.find(index);
  // The head of the CSV file is its first line.
  if (its != own.end() && its->second.contains(property) && !each_file.empty()) return {each_file, index + 1, 0};
  const auto whole = places.find("");
  return whole == places.end() ? config::Location{} : whole->second;
}

namespace {

Manifest read(YamlSection& top, const FindPlugin& find_plugin, const ReadFile& read_file) {
  Manifest manifest;
  manifest.fleet = checked_name(top, "fleet", top.require_string("fleet"));
  if (!top.has("deployments") && !top.has("topologies"))
    top.refuse("", "the key \"deployments\" is missing",
               "add \"deployments:\"; {} takes everything away that this manifest deployed");
  for (auto& [name, section] : top.sections("deployments"))
    manifest.deployments.push_back(read_deployment(name, section, find_plugin, read_file));
  for (auto& [name, section] : top.sections("topologies")) manifest.topologies.push_back(read_topology(name, section));
  top.finish();
  return manifest;
}

}  // namespace

Manifest read_manifest(config::YamlSection top, const FindPlugin& find_plugin, const ReadFile& read_file) {
  Manifest manifest;
  top.all_errors([&] { manifest = read(top, find_plugin, read_file); });
  return manifest;
}

Manifest load_manifest(const std::string& file) {
  const auto folder = std::filesystem::path(file).parent_path();
  const auto find_plugin = [&](const std::string& named) {
    const std::string path = folder / named;
    const std::string bytes = plugin_bytes(path);
    return PluginFile{path, security::sha256_hex(bytes), config::declaration_in(bytes)};
  };
  Manifest manifest;
  config::YamlSection::read_file(file, [&](YamlSection& top) {
    manifest = read(top, find_plugin, [&](const std::string& named) { return text_of_file(folder / named); });
  });
  for (auto& topology : manifest.topologies) topology.file = folder / topology.file;
  return manifest;
}

}  // namespace iotcloud::master::cli
