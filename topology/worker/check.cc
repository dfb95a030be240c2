#include <filesystem>

#include <nlohmann/json.hpp>

#include <iotcloud/topology/definition/describe.h>
#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/runtime/component_library.h>
#include <iotcloud/topology/worker/check.h>

namespace iotcloud::topology {

namespace {

/// Looks for the library as given, beside the YAML file, and in the folders. If it finds none it returns the name as
/// given, so that the loader's message has it.
std::string find_library(const std::string& name, const std::string& yaml_file,
                         const std::vector<std::string>& folders) {
  namespace fs = std::filesystem;
  if (fs::path(name).is_absolute()) return name;
  std::vector<fs::path> places{fs::path(yaml_file).parent_path() / name};
  for (const auto& folder : folders) places.push_back(fs::path(folder) / name);
  for (const auto& place : places) {
    std::error_code ignored;
    if (fs::exists(place, ignored)) return fs::absolute(place).string();
  }
  return name;
}

}  // namespace

std::vector<std::string> load_libraries(const TopologyDefinition& definition, const std::vector<std::string>& folders,
                                        ComponentRegistry& components,
                                        const std::map<std::string, std::string>& known) {
  std::vector<std::string> paths;
  for (const auto& name : definition.libraries) {
    const auto at = known.find(name);
    paths.push_back(at != known.end() ? at->second : find_library(name, definition.file, folders));
    try {
      load_components(paths.back(), components);
    } catch (const config::Error& error) {
      throw definition.root.error("topology.library", error.what());
    }
  }
  return paths;
}

namespace {

enum class RunsOn { this_machine, others };

/// Reads a topology's YAML, puts its graph together, and calls `use` with both if nothing is wrong.
/// \throws config::ConfigError.
template <typename Use>
void read_and_assemble(const std::string& file, RunsOn where, const std::vector<std::string>& folders,
                       ComponentRegistry components, const Use& use) {
  config::YamlSection::read_file(file, [&](config::YamlSection& root) {
    if (where == RunsOn::others) root.is_for_another_machine();
    const auto definition = TopologyDefinition::read(root, file);
    load_libraries(definition, folders, components);
    config::Metrics unused;
    const auto services = std::make_shared<EndpointServices>();
    services->topology = definition.name;
    services->clock = &config::system_clock();
    services->metrics = &unused;
    const Topology topology = assemble(definition, components, endpoint_factories(services));
    if (!root.has_errors()) use(definition, topology);
  });
}

std::string one_line(const nlohmann::ordered_json& answer) {
  return answer.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

std::string check_topology(const std::string& file, const std::vector<std::string>& folders,
                           ComponentRegistry components) {
  std::string description;
  read_and_assemble(
      file, RunsOn::this_machine, folders, std::move(components),
      [&](const auto& definition, const auto& topology) { description = describe(definition, topology); });
  return description;
}

std::string check_submission(const std::string& file, const std::vector<std::string>& folders) {
  nlohmann::ordered_json answer;
  try {
    read_and_assemble(file, RunsOn::others, folders, {}, [&](const auto& definition, const auto& topology) {
      if (definition.registry.url.empty()) {
        throw definition.root.error("", "the key \"zk.servers\" is missing",
                                    "add \"zk.servers: [\\\"host:2181\\\"]\": its workers run on other machines");
      }
      auto libraries = nlohmann::ordered_json::array();
      for (const auto& name : definition.libraries) {
        libraries.push_back({{"name", name}, {"path", find_library(name, file, folders)}});
      }
      answer = {{"topology", definition.name.str()},
                {"libraries", std::move(libraries)},
                {"crossings", crossings(definition, topology)},
                {"registry", definition.registry.url}};
    });
  } catch (const std::exception& error) {
    answer = {{"error", error.what()}};
  }
  return one_line(answer);
}

std::string check_library(const std::string& file) {
  nlohmann::ordered_json answer;
  try {
    ComponentRegistry components;
    load_components(file, components);
    answer = {{"spouts", components.spout_names()},
              {"bolts", components.bolt_names()},
              {"groupings", components.grouping_names()},
              {"application", static_cast<bool>(components.application())},
              {"sdk_version", sdk_version},
              {"cxx_abi", cxx_abi}};
  } catch (const std::exception& error) {
    answer = {{"error", error.what()}};
  }
  return one_line(answer);
}

}  // namespace iotcloud::topology
