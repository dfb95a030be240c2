// plugin check: no master is asked; plugin list, describe
#include <algorithm>
#include <cstring>
#include <filesystem>
#include <map>
#include <ostream>
#include <set>
#include <string>
#include <tuple>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

using nlohmann::ordered_json;

/// The program that loads plugins of a kind, as it would on a gateway or in a worker, and how it is asked to.
struct Loader {
  const char* kind;
  const char* symbol;  ///< which plugins of this kind export
  const char* program;
  const char* option;
};
constexpr Loader loaders[] = {
    {"driver plugin", "iotcloud_driver_descriptor", "iotcloud-driver-host", "--check"},
    {"component library", "iotcloud_topology_library", "iotcloud-topology", "--check-library"},
};

/// What the loader says of the file: its last line. A process of its own loads the file, because code runs when a
/// library is loaded.
ordered_json answer_of(const Loader& loader, const std::string& file) {
  const auto ended = run_sibling(loader.program, {loader.option, std::filesystem::absolute(file)});
  if (ended.signal != 0)
    throw config::Error(
        fmt::format("{}: a process that loads it is killed by SIG{}; the code that runs when it is "
                    "loaded is in its static objects",
                    file, sigabbrev_np(ended.signal)));
  const auto end = ended.output.find_last_not_of('\n');
  const auto begin = end == std::string::npos ? 0 : ended.output.rfind('\n', end) + 1;
  auto answer = ordered_json::parse(ended.output.substr(begin), nullptr, false);
  if (!answer.is_object())
    throw config::Error(fmt::format("{}: a process that loads it ended with status {}, and said: {}", file,
                                    ended.status, printable(ended.output)));
  if (answer.contains("error")) throw config::Error(answer["error"].get<std::string>());
  return answer;
}

void print_properties(std::ostream& out, const config::DriverDeclaration& declaration) {
  if (!declaration.properties) {
    out << "it declares no properties, and takes any\n";
    return;
  }
  if (declaration.properties->empty()) {
    out << "it has no properties\n";
    return;
  }
  std::vector<std::vector<std::string>> rows;
  for (const auto& property : *declaration.properties) {
    const std::string value = property.required ? "required" : property.default_value.value_or("-");
    rows.push_back({printable(property.name), printable(property.values()),
                    property.unit.empty() ? "-" : printable(property.unit), value.empty() ? "\"\"" : printable(value),
                    printable(property.text)});
  }
  print_table(out, {"PROPERTY", "TAKES", "UNIT", "DEFAULT", "WHAT IT IS"}, rows);
}

/// The same plugin on some gateways.
struct SamePlugin {
  discovery::KnownPlugin plugin;
  config::DriverDeclaration declaration;
  std::vector<discovery::GatewayId> gateways;
};

std::vector<SamePlugin> grouped(const std::vector<GatewayPlugin>& plugins) {
  using Key = std::tuple<std::string, std::string, std::string, std::string, bool>;
  std::map<Key, SamePlugin> groups;
  for (const auto& [gateway, plugin] : plugins) {
    auto& group = groups[{plugin.file, plugin.sha256, plugin.signed_by, plugin.problem, plugin.sent}];
    if (group.gateways.empty()) {
      group.plugin = plugin;
      group.declaration = config::parse_declaration(plugin.declaration);
    }
    group.gateways.push_back(gateway);
  }
  std::vector<SamePlugin> all;
  for (auto& [key, group] : groups) all.push_back(std::move(group));
  return all;
}

std::string signer(const discovery::KnownPlugin& plugin) {
  if (plugin.signed_by.empty()) return "-";
  return plugin.signed_version == 0 ? plugin.signed_by
                                    : fmt::format("{}, version {}", plugin.signed_by, plugin.signed_version);
}

ordered_json json_of(const SamePlugin& one) {
  auto json = ordered_json::parse(config::to_json(one.declaration));
  ordered_json all{{"plugin", one.plugin.file},         {"sha256", one.plugin.sha256},
                   {"size", one.plugin.size},           {"sent", one.plugin.sent},
                   {"signed_by", one.plugin.signed_by}, {"signed_version", one.plugin.signed_version},
                   {"problem", one.plugin.problem},     {"gateways", one.gateways}};
  all.update(json);
  return all;
}

class ListPlugins final : public Verb {
 public:
  ListPlugins()
      : Verb({"list", "List the plugins that gateways have: in their folders, and those that were sent",
              "iotcloud plugin list --gateway lab1", security::Role::viewer}) {}
  void declare(CLI::App& options) override {
    add_gateways(options, gateways_, "only of these gateways").allow_extra_args();
  }
  int run(Call& call) override {
    const auto answer = call.connect()->plugins(gateways_);
    std::vector<std::vector<std::string>> rows;
    ordered_json json = ordered_json::array();
    for (const auto& one : grouped(answer.plugins)) {
      const auto or_dash = [](const std::string& text) { return text.empty() ? "-" : printable(text); };
      rows.push_back({or_dash(one.plugin.file), or_dash(one.declaration.driver), or_dash(one.declaration.version),
                      security::short_sha256(one.plugin.sha256), printable(signer(one.plugin)),
                      one.plugin.sent ? "sent" : "folder", printable(fmt::format("{}", fmt::join(one.gateways, ", "))),
                      printable(one.plugin.problem)});
      json.push_back(json_of(one));
    }
    print(call.out, call.format, {"PLUGIN", "DRIVER", "VERSION", "SHA-256", "SIGNED BY", "FROM", "GATEWAYS", "PROBLEM"},
          rows, json);
    return name_silent(answer.silent, "the list of plugins", call.err);
  }

 private:
  std::vector<discovery::GatewayId> gateways_;
};

class DescribePlugin final : public Verb {
 public:
  DescribePlugin()
      : Verb({"describe",
              "Show what a plugin says of itself: its driver, and the properties that a deployment may give. It is "
              "read, not loaded",
              "iotcloud plugin describe turtle.so\n  iotcloud plugin describe ./weather.so", security::Role::viewer}) {}
  void declare(CLI::App& options) override {
    options
        .add_option("PLUGIN", plugin_,
                    "a file of this machine (./turtle.so, asks no master), or the name or the SHA-256 of a plugin that "
                    "gateways have")
        ->required();
    add_gateways(options, gateways_, "only of these gateways");
  }
  int run(Call& call) override {
    if (is_local_plugin(plugin_)) {
      const std::string bytes = plugin_bytes(plugin_);
      SamePlugin one;
      one.plugin.file = plugin_;
      one.plugin.sha256 = security::sha256_hex(bytes);
      one.plugin.size = static_cast<std::int64_t>(bytes.size());
      one.declaration = config::declaration_in(bytes);
      show(call, {one}, {});
      return exit_ok;
    }
    const auto master = call.connect();
    const auto answer = master->plugins(gateways_);
    auto found = grouped(answer.plugins);
    std::erase_if(found, [&](const SamePlugin& one) {
      return one.plugin.file != plugin_ && !one.plugin.sha256.starts_with(plugin_);
    });
    if (found.empty()) {
      static_cast<void>(name_silent(answer.silent, "the list of plugins", call.err));
      throw RequestFailed(fmt::format("no gateway has a plugin \"{}\"; `iotcloud plugin list` lists them", plugin_));
    }
    show(call, found, master->drivers());
    return name_silent(answer.silent, "the list of plugins", call.err);
  }

 private:
  /// The channels of the instances that run the plugin: "data (out)".
  static std::set<std::string> channels_of(const SamePlugin& one, const std::vector<discovery::DriverRecord>& drivers) {
    std::set<std::string> channels;
    for (const auto& driver : drivers) {
      if (driver.plugin != one.plugin.file || driver.sha256 != one.plugin.sha256) continue;
      for (const auto& channel : driver.channels)
        channels.insert(
            fmt::format("{} ({})", channel.name, channel.direction == discovery::Direction::out ? "out" : "in"));
    }
    return channels;
  }

  static void show(Call& call, const std::vector<SamePlugin>& plugins,
                   const std::vector<discovery::DriverRecord>& drivers) {
    ordered_json json = ordered_json::array();
    for (const auto& one : plugins) {
      const auto channels = channels_of(one, drivers);
      if (call.format != Format::table) {
        json.push_back(json_of(one));
        json.back()["channels"] = channels;
        continue;
      }
      if (&one != &plugins.front()) call.out << '\n';
      const auto or_dash = [](const std::string& text) { return text.empty() ? "-" : printable(text); };
      print_table(call.out, {"plugin", printable(one.plugin.file)},
                  {{"driver", or_dash(one.declaration.driver)},
                   {"version", or_dash(one.declaration.version)},
                   {"what it is", or_dash(one.declaration.description)},
                   {"driver SDK", std::to_string(one.declaration.sdk_version)},
                   {"SHA-256", one.plugin.sha256},
                   {"signed by", printable(signer(one.plugin))},
                   {"gateways", or_dash(fmt::format("{}", fmt::join(one.gateways, ", ")))},
                   {"channels", or_dash(fmt::format("{}", fmt::join(channels, ", ")))}});
      call.out << '\n';
      print_properties(call.out, one.declaration);
    }
    if (call.format != Format::table) print_data(call.out, call.format, json);
  }

  std::string plugin_;
  std::vector<discovery::GatewayId> gateways_;
};

class CheckPlugin final : public Verb {
 public:
  CheckPlugin()
      : Verb({"check",
              "Load a plugin as a gateway or a worker would, and say what it is, or what is missing: nothing is sent",
              "iotcloud plugin check ./weather.so", std::nullopt}) {}
  void declare(CLI::App& options) override { options.add_option("FILE", file_, "the plugin")->required(); }
  int run(Call& call) override {
    const std::string bytes = plugin_bytes(file_);
    std::vector<ordered_json> found;
    for (const Loader& loader : loaders) {
      if (bytes.find(loader.symbol) == std::string::npos) continue;
      ordered_json answer{{"file", file_}, {"kind", loader.kind}};
      answer.update(answer_of(loader, file_));
      found.push_back(std::move(answer));
    }
    if (found.empty())
      throw config::Error(
          fmt::format("{} is no plugin: it exports neither {} (IOTCLOUD_DRIVER) nor {} "
                      "(IOTCLOUD_TOPOLOGY_LIBRARY)",
                      file_, loaders[0].symbol, loaders[1].symbol));
    for (const auto& plugin : found) show(call, plugin);
    return exit_ok;
  }

 private:
  static void show(Call& call, const ordered_json& plugin) {
    if (call.format != Format::table) {
      print_data(call.out, call.format, plugin);
      return;
    }
    call.out << printable(plugin["file"].get<std::string>()) << ": a " << plugin["kind"].get<std::string>()
             << " that can be loaded\n";
    for (const auto& [key, value] : plugin.items()) {
      if (key == "file" || key == "kind" || key == "properties" || value.empty()) continue;
      call.out << fmt::format("  {:<12} {}\n", key,
                              printable(value.is_string() ? value.get<std::string>() : value.dump()));
    }
    if (!plugin.contains("properties")) return;
    call.out << '\n';
    print_properties(call.out, config::parse_declaration(plugin.dump()));
  }

  std::string file_;
};

}  // namespace

void add_plugin_verbs(Verbs& verbs) {
  auto& group = verbs.group("plugin", "Plugins of drivers, and component libraries");
  group.add<ListPlugins>();
  group.add<DescribePlugin>();
  group.add<CheckPlugin>();
}

}  // namespace iotcloud::master::cli
