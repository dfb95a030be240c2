// plugin check: no master is asked
#include <cstring>
#include <filesystem>
#include <ostream>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/verb.h>

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
      if (key == "file" || key == "kind" || value.empty()) continue;
      call.out << fmt::format("  {:<12} {}\n", key,
                              printable(value.is_string() ? value.get<std::string>() : value.dump()));
    }
  }

  std::string file_;
};

}  // namespace

void add_plugin_verbs(Verbs& verbs) {
  verbs.group("plugin", "Plugins of drivers, and component libraries").add<CheckPlugin>();
}

}  // namespace iotcloud::master::cli
