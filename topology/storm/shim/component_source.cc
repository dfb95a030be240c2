#include <algorithm>
#include <filesystem>
#include <map>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/runtime/component_library.h>
#include <iotcloud/topology/storm/shim/component_source.h>

namespace iotcloud::topology::storm {

namespace {

namespace fs = std::filesystem;

/// A task's endpoint cannot be made: `iotcloud-storm` refuses such a topology.
EndpointFactories no_endpoints() {
  const auto refuse = [](const ComponentDefinition& component) -> config::Error {
    return config::Error(component.id + " faces a broker, which does not run on Storm");
  };
  return {.spout = [=](const ComponentDefinition& spout) -> SpoutFactory { throw refuse(spout); },
          .bolt = [=](const ComponentDefinition& bolt) -> BoltFactory { throw refuse(bolt); }};
}

/// What this process has read so far. It keeps it to its end, because tasks use it.
class Sources {
 public:
  const Topology& topology_of(const std::string& file) {
    const config::MutexLock lock(mutex_);
    const auto known = topologies_.find(file);
    return known != topologies_.end() ? known->second : topologies_.emplace(file, load(file)).first->second;
  }
  const ComponentRegistry& registry_of(const std::string& library) {
    const config::MutexLock lock(mutex_);
    const auto [known, fresh] = libraries_.try_emplace(library);
    if (fresh) {
      try {
        load_components(library, known->second);
      } catch (...) {
        libraries_.erase(known);
        throw;
      }
    }
    return known->second;
  }

 private:
  /// The libraries lie beside the file, wherever they were when it was packed.
  static Topology load(const std::string& file) {
    const TopologyDefinition definition = TopologyDefinition::load(file);
    ComponentRegistry components;
    for (const auto& library : definition.libraries) {
      load_components(fs::path(file).parent_path() / fs::path(library).filename(), components);
    }
    return assemble(definition, components, no_endpoints());
  }

  config::Mutex mutex_;
  std::map<std::string, Topology> topologies_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::string, ComponentRegistry> libraries_ IOTCLOUD_GUARDED_BY(mutex_);
};

Sources& sources() {
  static Sources& all = *new Sources;
  return all;
}

const ComponentSpec& find(const Topology& topology, const std::string& id, const std::string& file) {
  const auto found = std::find_if(topology.components.begin(), topology.components.end(),
                                  [&](const ComponentSpec& component) { return component.id == id; });
  if (found == topology.components.end()) throw config::Error(file + " has no component \"" + id + "\"");
  return *found;
}

}  // namespace

ComponentSpec component_of(const TaskDescription& task) {
  const fs::path folder = task.folder;
  if (!task.file.empty()) {
    const std::string file = folder / task.file;
    const Topology& topology = sources().topology_of(file);
    ComponentSpec spec = find(topology, task.component, file);
    spec.config.insert(topology.config.begin(), topology.config.end());
    return spec;
  }
  const std::string library = folder / task.library;
  const ComponentRegistry& registry = sources().registry_of(library);
  ComponentSpec spec;
  spec.id = task.component;
  spec.config = task.conf;
  if (const SpoutFactory* spout = registry.spout(task.class_name)) spec.spout = *spout;
  if (const BoltFactory* bolt = registry.bolt(task.class_name)) spec.bolt = *bolt;
  if (!spec.spout && !spec.bolt) throw config::Error(library + " registers no class \"" + task.class_name + "\"");
  if (spec.bolt) spec.tick = spec.bolt()->tick_period(spec.config);
  return spec;
}

std::unique_ptr<Grouping> grouping_of(const std::string& file, const std::string& bolt, std::size_t input) {
  const ComponentSpec& spec = find(sources().topology_of(file), bolt, file);
  if (input >= spec.inputs.size() || !spec.inputs[input].factory) {
    throw config::Error(file + ": bolt \"" + bolt + "\" has no grouping for its input " + std::to_string(input));
  }
  return spec.inputs[input].factory();
}

}  // namespace iotcloud::topology::storm
