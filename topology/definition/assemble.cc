#include <algorithm>
#include <map>

#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/definition/describe.h>

namespace iotcloud::topology {

namespace {

/// Returns the factory of a class, or throws an error that lists the known classes.
template <typename Factory>
const Factory& find_class(const config::YamlSection& section, const std::string& name, const Factory* found,
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
  config::YamlSection root = definition.root;
  for (const char* group : {"spouts", "bolts"}) {
    if (!root.has(group)) continue;
    const config::YamlSection section = root.require_section(group);
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

void refuse_unknown_source(const InputDefinition& input, const std::vector<std::string>& known) {
  const std::string guess = config::nearest(input.from, known);
  std::string list;
  for (const auto& name : known) list += (list.empty() ? "\"" : ", \"") + name + "\"";
  input.section.refuse("from", "there is no component \"" + input.from + "\"",
                       guess.empty() ? "the file has " + list : "did you mean \"" + guess + "\"?");
}

void refuse_unknown_sources(const TopologyDefinition& definition, const TopologyBuilder& builder) {
  std::vector<std::string> known;
  for (const auto* group : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *group) known.push_back(component.id);
  }
  for (const auto& bolt : definition.bolts) {
    for (const auto& input : bolt.inputs) {
      const bool in_file = std::find(known.begin(), known.end(), input.from) != known.end();
      if (!in_file && !builder.has(input.from)) refuse_unknown_source(input, known);
    }
  }
}

/// Refuses what components say of themselves, such as keys of `conf` that they do not take, at the key's own place.
void refuse_troubled_components(const TopologyDefinition& definition, const TopologyBuilder& builder) {
  for (const ComponentTrouble& trouble : builder.troubles(definition.conf)) {
    const auto is_it = [&](const ComponentDefinition& component) { return component.id == trouble.component; };
    const auto refuse_in = [&](const std::vector<ComponentDefinition>& group) {
      const auto component = std::find_if(group.begin(), group.end(), is_it);
      if (component == group.end()) return false;
      const bool own = component->conf.contains(trouble.conf_key);
      if (!own && !definition.conf.contains(trouble.conf_key)) return false;
      config::YamlSection owner = own ? component->section : definition.root;
      owner.require_section("conf").refuse(trouble.conf_key, trouble.text);
      return true;
    };
    if (refuse_in(definition.spouts) || refuse_in(definition.bolts)) continue;
    definition.root.refuse(at_its_place(definition, TopologyError(trouble.component, trouble.text)));
  }
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
        bolt.section.refuse("fields", "its input \"" + input.from + "\" has no field \"" + field + "\"",
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

/// A time as the file writes it: "10s", "250ms".
std::string as_text(std::chrono::microseconds time) {
  const auto ms = std::chrono::ceil<std::chrono::milliseconds>(time).count();
  return ms % 1000 == 0 ? std::to_string(ms / 1000) + "s" : std::to_string(ms) + "ms";
}

/// Refuses bolts that keep tuples for longer than the message time-out allows: every one of them would fail. Only on
/// the way from spouts of this file that track their tuples, because a class may emit tuples that nothing tracks.
void check_holds(const TopologyDefinition& definition, const Topology& topology) {
  if (!definition.runtime.acking) return;
  struct Way {
    std::chrono::microseconds held{0};
    std::string bolts;  ///< those that hold, with their times
  };
  std::map<std::string, Way> longest;  // by component that tracked tuples reach
  for (const auto& spout : definition.spouts) {
    if (spout.endpoint && !spout.endpoint->reading.automatic_ack) longest[spout.id];
  }
  for (const auto& component : topology.components) {
    for (const auto& input : component.inputs) {
      const auto before = longest.find(input.from);
      if (before == longest.end()) continue;
      Way way = before->second;
      const bool for_a_time = component.holds.count() > 0 && component.holds != Bolt::until_others_come;
      if (for_a_time) {
        way.held += component.holds;
        way.bolts += (way.bolts.empty() ? "" : ", then ") + component.id + " " + as_text(component.holds);
      }
      if (for_a_time && way.held >= definition.runtime.message_timeout) {
        throw TopologyError(
            component.id, "tuples are kept for longer than the message time-out, so each of them would fail (" +
                              way.bolts + "; runtime.message_timeout is " +
                              as_text(definition.runtime.message_timeout) + "); set runtime.message_timeout to twice " +
                              as_text(way.held) + ", or make the window shorter");
      }
      if (auto& place = longest[component.id]; place.held <= way.held) place = std::move(way);
    }
  }
}

}  // namespace

Topology assemble(const TopologyDefinition& definition, const ComponentRegistry& components,
                  const EndpointFactories& endpoints) {
  Topology topology;
  const config::YamlSection& root = definition.root;
  // Runs a step of which another one does not depend, and notes its error.
  const auto step = [&](const auto& make) {
    root.part([&] {
      try {
        make();
      } catch (const TopologyError& error) {
        throw at_its_place(definition, error);
      }
    });
  };
  root.all_errors([&] {
    TopologyBuilder builder;
    // Of a component with neither class nor broker the reader has said so.
    const auto known = [](const ComponentDefinition& component) {
      return component.endpoint || !component.class_name.empty();
    };
    for (const auto& spout : definition.spouts) {
      if (known(spout)) step([&] { add_spout(builder, spout, components, endpoints); });
    }
    for (const auto& bolt : definition.bolts) {
      if (known(bolt)) step([&] { add_bolt(builder, bolt, components, endpoints); });
    }
    // The application expects all components of the file.
    if (components.application() && !root.has_errors()) {
      step([&] { apply(components.application(), builder, definition); });
    }
    for (const auto& bolt : definition.bolts) {
      if (builder.has(bolt.id)) step([&] { connect_inputs(builder, bolt, components); });
    }
    if (!components.application() || !root.has_errors()) refuse_unknown_sources(definition, builder);
    refuse_troubled_components(definition, builder);
    // What follows needs the whole graph.
    if (root.has_errors()) return;
    step([&] {
      topology = builder.build(definition.name, definition.conf);
      check_sent_fields(definition, topology);
      check_shared_spouts(definition, topology);
      check_holds(definition, topology);
    });
  });
  return topology;
}

}  // namespace iotcloud::topology
