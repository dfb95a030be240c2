#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/runtime/component_library.h>
#include <iotcloud/topology/storm/shim/component_source.h>
#include <iotcloud/topology/storm/shim/worker_pages.h>

namespace iotcloud::topology::storm {

namespace {

namespace fs = std::filesystem;

/// A topology's file as this process has read it.
struct ReadFile {
  Topology topology;
  std::set<std::string> endpoints;  ///< the components that face brokers
  std::unique_ptr<EndpointProcess> process;
  std::unique_ptr<WorkerPages> pages;
};

/// What this process has read so far. It keeps it to its end, because tasks use it.
class Sources {
 public:
  const ReadFile& read(const std::string& file) {
    const config::MutexLock lock(mutex_);
    const auto known = files_.find(file);
    return known != files_.end() ? known->second : files_.emplace(file, load(file)).first->second;
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
  static ReadFile load(const std::string& file) {
    const TopologyDefinition definition = TopologyDefinition::load(file);
    ComponentRegistry components;
    for (const auto& library : definition.libraries) {
      load_components(fs::path(file).parent_path() / fs::path(library).filename(), components);
    }
    ReadFile read;
    read.process = std::make_unique<EndpointProcess>(definition);
    read.topology = assemble(definition, components, read.process->factories());
    read.process->complete(read.topology);
    for (const auto* group : {&definition.spouts, &definition.bolts}) {
      for (const auto& component : *group) {
        if (component.endpoint) read.endpoints.insert(component.id);
      }
    }
    read.pages = std::make_unique<WorkerPages>(definition.pages);
    return read;
  }

  config::Mutex mutex_;
  std::map<std::string, ReadFile> files_ IOTCLOUD_GUARDED_BY(mutex_);
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

Component component_of(const TaskDescription& task) {
  const fs::path folder = task.folder;
  if (!task.file.empty()) {
    const std::string file = folder / task.file;
    const ReadFile& read = sources().read(file);
    ComponentSpec spec = find(read.topology, task.component, file);
    spec.config.insert(read.topology.config.begin(), read.topology.config.end());
    return {std::move(spec), read.endpoints.contains(task.component) ? read.process.get() : nullptr};
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
  return {std::move(spec), nullptr};
}

std::unique_ptr<Grouping> grouping_of(const TaskDescription& emitter, const std::string& bolt, std::size_t input) {
  const fs::path folder = emitter.folder;
  if (emitter.file.empty()) {
    const std::string library = folder / emitter.library;
    const GroupingFactory* made = sources().registry_of(library).grouping(emitter.class_name);
    if (made == nullptr) throw config::Error(library + " registers no grouping \"" + emitter.class_name + "\"");
    return (*made)();
  }
  const std::string file = folder / emitter.file;
  const ComponentSpec& spec = find(sources().read(file).topology, bolt, file);
  if (input >= spec.inputs.size() || !spec.inputs[input].factory) {
    throw config::Error(file + ": bolt \"" + bolt + "\" has no grouping for its input " + std::to_string(input));
  }
  return spec.inputs[input].factory();
}

}  // namespace iotcloud::topology::storm
