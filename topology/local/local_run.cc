#include <algorithm>
#include <filesystem>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/local/local_run.h>
#include <iotcloud/topology/worker/pages.h>

namespace iotcloud::local {

namespace {

namespace fs = std::filesystem;

/// The logical names of the brokers that the topology uses.
std::set<std::string> brokers_of(const topology::TopologyDefinition& definition) {
  std::set<std::string> names;
  for (const auto* components : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *components) {
      if (component.endpoint) names.insert(component.endpoint->broker);
    }
  }
  if (names.empty()) names.insert("rabbitmq");
  return names;
}

/// The topology's file, without the servers that it names: those of the run replace them.
topology::TopologyDefinition load(const RunOptions& options) {
  auto definition = topology::TopologyDefinition::load(options.topology);
  definition.brokers.clear();
  return definition;
}

std::string folder_of(const std::vector<std::string>& plugins) {
  std::string folder;
  for (const auto& plugin : plugins) {
    if (!fs::exists(plugin)) throw config::Error(fmt::format("there is no plugin {}", plugin));
    const std::string its = fs::absolute(plugin).parent_path();
    if (!folder.empty() && its != folder)
      throw config::Error(
          fmt::format("{} is not in {} as the other plugins are; put them into one folder", plugin, folder));
    folder = its;
  }
  return folder;
}

LocalOptions cluster_options(const RunOptions& options) {
  LocalOptions cluster;
  cluster.name = fmt::format("run-{}", getpid());
  cluster.registry_url = options.registry_url;
  if (!options.registry_url.empty()) cluster.own_root = "/iotcloud-run-" + discovery::new_instance_id();
  cluster.plugin_dir = folder_of(options.plugins);
  cluster.library_folders = options.library_folders;
  cluster.brokers.clear();
  for (const auto& name : brokers_of(load(options))) cluster.brokers.emplace_back(name, options.broker_url);
  return cluster;
}

/// "250/s"
std::string rate(std::uint64_t before, std::uint64_t now, double seconds) {
  return fmt::format("{:.0f}/s", static_cast<double>(now - std::min(before, now)) / seconds);
}

}  // namespace

std::vector<std::string> files_of(const RunOptions& options) {
  std::vector<std::string> files = options.plugins;
  files.push_back(options.topology);
  std::vector<fs::path> folders{fs::path(options.topology).parent_path()};
  for (const auto& plugin : options.plugins) folders.push_back(fs::path(plugin).parent_path());
  try {
    for (const auto& library : topology::TopologyDefinition::load(options.topology).libraries) {
      for (const auto& folder : folders) files.push_back(folder / library);
    }
  } catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): who runs the file says what is wrong with it
  }
  return files;
}

LocalRun::LocalRun(const RunOptions& options, const std::stop_token& stop)
    : cluster_(cluster_options(options)), worker_(&cluster_.run_topology(load(options))) {
  const std::stop_callback end_of_waiting(stop, [this] { cluster_.master().close(); });
  for (const auto& plugin : options.plugins) {
    master::DeployRequest request;
    request.plugin = fs::path(plugin).filename();
    request.properties = options.properties;
    request.count = options.count;
    for (int i = 1; i <= options.count; ++i) {
      if (auto own = config::numbered(options.properties, i); !own.empty()) request.own.push_back({i, std::move(own)});
    }
    const auto result = cluster_.master().deploy(request);
    if (!result.all_done())
      throw config::Error(fmt::format("{}: {}", plugin, result.text.empty() ? result.summary() : result.text));
  }
  if (options.registry_url.empty()) find_without_driver(options);
  static_cast<void>(news());  // opens the taps, and begins to count
}

void LocalRun::find_without_driver(const RunOptions& options) {
  std::vector<std::string> drivers;
  for (const auto& driver : cluster_.master().drivers()) drivers.push_back(driver.name.str());
  std::sort(drivers.begin(), drivers.end());
  drivers.erase(std::unique(drivers.begin(), drivers.end()), drivers.end());
  const auto definition = load(options);
  for (const auto* components : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *components) {
      if (!component.endpoint) continue;
      const std::string wanted = component.endpoint->driver.str();
      if (std::binary_search(drivers.begin(), drivers.end(), wanted)) continue;
      const std::string near = config::nearest(wanted, drivers);
      const std::string remedy = drivers.empty() ? "name its file with --plugin FILE"
                                 : near.empty()  ? fmt::format("there is \"{}\"", fmt::join(drivers, "\", \""))
                                                 : fmt::format("did you mean \"{}\"?", near);
      without_driver_.push_back(
          fmt::format("{}: no plugin of this run is the driver \"{}\"; {}", component.id, wanted, remedy));
    }
  }
}

std::string LocalRun::instances() {
  std::map<std::string, std::map<std::string, int>> counts;
  std::string reasons;
  for (const auto& driver : cluster_.master().drivers()) {
    ++counts[driver.name.str()][discovery::to_string(driver.state)];
    if (driver.state == discovery::DriverState::failed) reasons = " (" + driver.reason + ")";
  }
  std::string text;
  for (const auto& [driver, states] : counts) {
    for (const auto& [state, count] : states)
      text +=
          fmt::format("{}{} {} {}{}", text.empty() ? "" : ", ", count, driver, state, state == "failed" ? reasons : "");
  }
  return text.empty() ? "no driver instance" : text;
}

std::string LocalRun::newest(const std::string& component) {
  constexpr std::size_t widest = 160;
  try {
    const auto page = nlohmann::ordered_json::parse(worker_->taps().poll("run-" + component, component, "", 1));
    const auto& samples = page.at("samples");
    if (samples.empty()) return "";
    std::string text = samples.back().at("fields").dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
    if (text.size() > widest) text = text.substr(0, widest) + "...";
    return text;
  } catch (const std::invalid_argument&) {
    return "";  // more components than taps
  }
}

std::vector<std::string> LocalRun::news() {
  const auto now = std::chrono::steady_clock::now();
  const double seconds = std::max(std::chrono::duration<double>(now - std::exchange(at_, now)).count(), 1e-3);
  std::vector<std::string> lines{instances()};
  auto after = worker_->snapshot();
  std::set<std::string> told;
  for (const auto& task : after.tasks) {
    if (!told.insert(task.component).second) continue;
    const auto was = before_.component(task.component), is = after.component(task.component);
    std::string line = fmt::format("  {}:", task.component);
    if (!task.spout) line += " took " + rate(was.executed, is.executed, seconds) + ",";
    line += " emitted " + rate(was.emitted, is.emitted, seconds);
    if (is.failed > was.failed) line += fmt::format(", failed {}", is.failed - was.failed);
    if (is.errors > was.errors) line += ", error: " + is.last_error;
    if (const std::string tuple = newest(task.component); !tuple.empty()) line += "  " + tuple;
    lines.push_back(std::move(line));
  }
  before_ = std::move(after);
  return lines;
}

}  // namespace iotcloud::local
