#include <algorithm>

#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/definition/describe.h>

namespace iotcloud::topology {

namespace {

/// Returns the factory of a class, or throws an error that lists the known classes.
template <typename Factory>
const Factory& find_class(const config::Section& section, const std::string& name, const Factory* found,
                          const std::vector<std::string>& known) {
  if (found != nullptr) return *found;
  std::string list;
  for (const auto& other : known) list += (list.empty() ? "\"" : ", \"") + other + "\"";
  const std::string guess = config::nearest(name, known);
  throw section.error("class", "there is no class \"" + name + "\"",
                      !guess.empty()  ? "did you mean \"" + guess + "\"?"
                      : known.empty() ? "name the library that registers it as \"topology.library\""
                                      : "the component libraries register " + list);
}

/// Turns an error of the graph into one that names the place of the file where it can be mended.
config::ConfigError at_its_place(const TopologyDefinition& definition, const TopologyError& error) {
  config::Section root = definition.root;
  for (const char* group : {"spouts", "bolts"}) {
    if (!root.has(group)) continue;
    const config::Section section = root.require_section(group);
    if (section.has(error.component())) return section.error(error.component(), error.what());
  }
  const bool application = !error.component().empty() && definition.root.has("topology.library");
  return definition.root.error(application ? "topology.library" : "", error.what());
}

/// The component with its endpoint's builder, if that is a class of a component library.
ComponentDefinition with_builder(const ComponentDefinition& component, const ComponentRegistry& components) {
  ComponentDefinition made = component;
  const std::string& name = made.endpoint->builder;
  std::vector<std::string> known = built_in_builders();
  if (std::find(known.begin(), known.end(), name) != known.end()) return made;
  if (const MessageBuilderFactory* found = components.builder(name)) {
    made.endpoint->make_builder = *found;
    return made;
  }
  for (const std::string& other : components.builder_names()) known.push_back(other);
  std::string list;
  for (const auto& other : known) list += (list.empty() ? "\"" : ", \"") + other + "\"";
  const std::string guess = config::nearest(name, known);
  throw component.section.error("builder", "there is no builder \"" + name + "\"",
                                guess.empty()
                                    ? "there are " + list + "; a library of \"topology.library\" may register others"
                                    : "did you mean \"" + guess + "\"?");
}

void connect_inputs(TopologyBuilder& builder, const ComponentDefinition& bolt, const ComponentRegistry& components) {
  auto declarer = builder.bolt(bolt.id);
  for (const auto& input : bolt.inputs) {
    if (input.grouping == "custom") {
      declarer.custom_grouping(input.from,
                               find_class(input.section, input.grouping_class,
                                          components.grouping(input.grouping_class), components.grouping_names()),
                               input.stream);
    } else {
      declarer.grouping(input.grouping, input.from, input.fields, input.stream);
    }
    if (input.deadline.count() > 0) declarer.input_deadline(input.deadline);
    if (input.keep_last > 0) declarer.keep_last(input.keep_last, input.keep_key);
  }
}

void add_spout(TopologyBuilder& builder, const ComponentDefinition& spout, const ComponentRegistry& components,
               const EndpointFactories& endpoints) {
  auto factory = spout.endpoint ? endpoints.spout(with_builder(spout, components))
                                : find_class(spout.section, spout.class_name, components.spout(spout.class_name),
                                             components.spout_names());
  auto declarer = builder.set_spout(spout.id, std::move(factory), spout.parallelism, spout.conf);
  declarer.tasks(spout.tasks);
  if (spout.max_spout_pending) declarer.max_pending(*spout.max_spout_pending);
}

void add_bolt(TopologyBuilder& builder, const ComponentDefinition& bolt, const ComponentRegistry& components,
              const EndpointFactories& endpoints) {
  auto factory = bolt.endpoint ? endpoints.bolt(with_builder(bolt, components))
                               : find_class(bolt.section, bolt.class_name, components.bolt(bolt.class_name),
                                            components.bolt_names());
  auto declarer = builder.set_bolt(bolt.id, std::move(factory), bolt.parallelism, bolt.conf);
  declarer.tasks(bolt.tasks);
  if (bolt.tick.count() > 0) declarer.tick(bolt.tick);
  if (bolt.deadline.count() > 0 || !bolt.late_stream.empty()) declarer.deadline(bolt.deadline, bolt.late_stream);
}

/// Runs the application's part of the graph. Its exceptions count as errors of the file.
void apply(const ComponentRegistry::Application& application, TopologyBuilder& builder,
           const TopologyDefinition& definition) {
  try {
    application(builder, definition.conf);
  } catch (const TopologyError&) {
    throw;
  } catch (const std::exception& e) {
    throw definition.root.error("topology.library",
                                std::string("the application could not put its graph together: ") + e.what());
  }
}

/// The first input whose source is missing, or nullptr.
const InputDefinition* unknown_input(const TopologyDefinition& definition, const TopologyBuilder& builder) {
  for (const auto& bolt : definition.bolts) {
    for (const auto& input : bolt.inputs) {
      if (!builder.has(input.from)) return &input;
    }
  }
  return nullptr;
}

[[noreturn]] void refuse_unknown_source(const TopologyDefinition& definition, const InputDefinition& input) {
  std::vector<std::string> known;
  for (const auto* group : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *group) known.push_back(component.id);
  }
  const std::string guess = config::nearest(input.from, known);
  std::string list;
  for (const auto& name : known) list += (list.empty() ? "\"" : ", \"") + name + "\"";
  throw input.section.error("from", "there is no component \"" + input.from + "\"",
                            guess.empty() ? "the file has " + list : "did you mean \"" + guess + "\"?");
}

/// Checks that a sending bolt's inputs have the fields that it sends.
void check_sent_fields(const TopologyDefinition& definition, const Topology& topology) {
  for (const auto& bolt : definition.bolts) {
    if (!bolt.endpoint) continue;
    const auto spec = std::find_if(topology.components.begin(), topology.components.end(),
                                   [&](const ComponentSpec& component) { return component.id == bolt.id; });
    for (const auto& input : spec->inputs) {
      const Fields& given = topology.streams.at(input.from).at(input.stream).fields;
      for (const auto& field : bolt.endpoint->fields) {
        if (given.find(field)) continue;
        throw bolt.section.error("fields", "its input \"" + input.from + "\" has no field \"" + field + "\"",
                                 "its fields are: " + given.list());
      }
    }
  }
}

/// Refuses inputs that group tuples of several drivers if a spout names a group: this topology has the tuples of some
/// drivers only, as other topologies of the group read the other drivers.
void check_shared_spouts(const TopologyDefinition& definition, const Topology& topology) {
  const auto shared =
      std::find_if(definition.spouts.begin(), definition.spouts.end(),
                   [](const ComponentDefinition& spout) { return spout.endpoint && !spout.endpoint->group.empty(); });
  if (shared == definition.spouts.end()) return;
  const std::string crossed = crossings(definition, topology);
  if (crossed.empty()) return;
  throw shared->section.error("group",
                              "other topologies of the group read some of the drivers, and these inputs reach across "
                              "drivers, of which there would be only a share here:\n" +
                                  crossed,
                              "if these bolts should process that share only, give them \"scope: worker\" (or write "
                              "\"topology.scope: worker\"); otherwise use a key with driverID, or no group");
}

}  // namespace

Topology assemble(const TopologyDefinition& definition, const ComponentRegistry& components,
                  const EndpointFactories& endpoints) {
  TopologyBuilder builder;
  try {
    for (const auto& spout : definition.spouts) add_spout(builder, spout, components, endpoints);
    for (const auto& bolt : definition.bolts) add_bolt(builder, bolt, components, endpoints);
    if (components.application()) apply(components.application(), builder, definition);
    for (const auto& bolt : definition.bolts) connect_inputs(builder, bolt, components);
    if (const auto* input = unknown_input(definition, builder)) refuse_unknown_source(definition, *input);
    auto topology = builder.build(definition.name, definition.conf);
    check_sent_fields(definition, topology);
    check_shared_spouts(definition, topology);
    return topology;
  } catch (const TopologyError& error) {
    throw at_its_place(definition, error);
  }
}

}  // namespace iotcloud::topology
