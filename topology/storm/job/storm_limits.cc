#include <algorithm>
#include <cctype>
#include <chrono>
#include <set>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/topology/storm/job/storm_limits.h>

namespace iotcloud::topology::storm {

namespace {

using config::YamlSection;
using std::chrono::microseconds;
using std::chrono::seconds;

/// What is checked, and where findings go.
struct Check {
  const TopologyDefinition& definition;
  const Topology& topology;
  std::vector<std::string> notes;
};

const ComponentDefinition* find_definition(const TopologyDefinition& definition, const std::string& id) {
  for (const auto* group : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *group) {
      if (component.id == id) return &component;
    }
  }
  return nullptr;
}

/// Refuses at a component's key; at the library's if an application made it.
void refuse(const Check& check, const std::string& component, const std::string& key, const std::string& problem,
            const std::string& remedy) {
  if (const auto* written = find_definition(check.definition, component)) {
    written->section.refuse(key, problem, remedy);
  } else {
    check.definition.root.refuse("topology.library", component + ": " + problem, remedy);
  }
}

std::string text_of(microseconds time) {
  return time % seconds(1) == seconds(0)
             ? fmt::format("{}s", time / seconds(1))
             : fmt::format("{}ms", std::chrono::ceil<std::chrono::milliseconds>(time).count());
}

void check_name(Check& check) {
  const std::string& name = check.definition.name.str();
  if (name.find_first_of("/.:\\") == std::string::npos) return;
  check.definition.root.refuse("topology.name", "Storm takes no \"/\", \".\", \":\" or \"\\\" in a topology's name",
                               "write \"-\", for example");
}

/// Endpoints need a registry and brokers that all workers reach.
void check_endpoints(Check& check) {
  const auto faces_broker = [](const ComponentDefinition& component) { return component.endpoint.has_value(); };
  const auto& definition = check.definition;
  if (std::none_of(definition.spouts.begin(), definition.spouts.end(), faces_broker) &&
      std::none_of(definition.bolts.begin(), definition.bolts.end(), faces_broker)) {
    return;
  }
  const std::string problem = "an embedded one is in one process only, and Storm has several";
  if (definition.registry.url.empty()) {
    definition.root.refuse("zk.servers", "the spouts and bolts that face brokers find the drivers in a registry",
                           "name ZooKeeper's servers: \"zk.servers: [host:2181]\"");
  } else if (definition.registry.url.starts_with("embedded:")) {
    definition.root.refuse("registry", problem, "name a ZooKeeper: \"zk.servers: [host:2181]\"");
  }
  for (const auto& [name, broker] : definition.brokers) {
    const auto is_embedded = [](const std::string& url) { return url.starts_with("embedded:"); };
    if (std::any_of(broker.urls.begin(), broker.urls.end(), is_embedded))
      YamlSection(definition.root).require_section("brokers").refuse(name, problem, "name a broker's server");
  }
}

void check_streams(Check& check) {
  for (const auto& [component, streams] : check.topology.streams) {
    for (const auto& [stream, spec] : streams) {
      if (!stream.starts_with("__")) continue;
      refuse(check, component, "class", "it declares the stream \"" + stream + "\"; such names are Storm's own",
             "give the stream another name");
    }
  }
}

/// Storm knows an input by component and stream alone.
void check_double_inputs(Check& check) {
  for (const auto& component : check.topology.components) {
    std::set<std::pair<std::string, std::string>> known;
    for (const auto& input : component.inputs) {
      if (known.emplace(input.from, input.stream).second) continue;
      refuse(check, component.id, "inputs",
             "Storm feeds a bolt once with the stream \"" + input.stream + "\" of " + input.from,
             "remove an input, or let another bolt take it");
    }
  }
}

/// `scope: worker` says that a result for each worker is meant; on Storm an input regroups over all of them.
void check_scope(Check& check) {
  for (const auto& bolt : check.definition.bolts) {
    if (!bolt.worker_scope && !check.definition.worker_scope) continue;
    const auto crosses = [](const InputDefinition& input) {
      const bool keyed = input.grouping == "fields" || input.grouping == "partial_key";
      const bool driver = input.fields.find("driverID") || input.fields.find("sensorID");
      return input.grouping == "global" || input.grouping == "all" || (keyed && !driver);
    };
    if (std::none_of(bolt.inputs.begin(), bolt.inputs.end(), crosses)) continue;
    const bool own = bolt.worker_scope;
    const YamlSection& section = own ? bolt.section : check.definition.root;
    section.refuse(own ? "scope" : "topology.scope",
                   "on Storm " + bolt.id + " gets the tuples of all workers, not those of its own",
                   "remove \"scope\" for one result of all workers, or run the topology with iotcloud-topology");
    if (!own) return;
  }
}

/// The state's place, if the component's configuration says it.
std::string store_of(const Check& check, const ComponentSpec& component) {
  const auto own = component.config.find("state.store");
  if (own != component.config.end()) return own->second;
  const auto all = check.definition.conf.find("state.store");
  return all != check.definition.conf.end() ? all->second : "";
}

YamlSection conf_with(const Check& check, const ComponentSpec& component, const std::string& key) {
  const auto* written = find_definition(check.definition, component.id);
  YamlSection owner = written != nullptr && written->conf.contains(key) ? written->section : check.definition.root;
  return owner.require_section("conf");
}

/// Tasks whose state is in this store.
int tasks_with(const Check& check, const std::string& store) {
  int tasks = 0;
  for (const auto& component : check.topology.components) {
    if (store_of(check, component) == store) tasks += component.tasks;
  }
  return tasks;
}

void check_state(Check& check) {
  for (const auto& component : check.topology.components) {
    const std::string store = store_of(check, component);
    if (store.starts_with("memory://")) {
      check.notes.push_back(component.id +
                            ": its state is in memory, so it is lost whenever Storm starts the worker anew");
    }
    constexpr std::string_view rocksdb = "rocksdb://";
    if (!store.starts_with(rocksdb)) continue;
    const std::string path = store.substr(rocksdb.size());
    const auto& shared = check.definition.storm.shared_folders;
    const auto has_it = [&](const std::string& folder) {
      return path.starts_with(folder.ends_with('/') ? folder : folder + "/");
    };
    if (std::any_of(shared.begin(), shared.end(), has_it)) {
      const int tasks = tasks_with(check, store);
      if (tasks == 1) continue;
      conf_with(check, component, "state.store")
          .refuse(
              "state.store",
              fmt::format("Storm may spread the {} tasks with this state over several workers, and one process at a "
                          "time opens a RocksDB",
                          tasks),
              "name a Redis, or give each component one task and a RocksDB of its own");
      continue;
    }
    conf_with(check, component, "state.store")
        .refuse(
            "state.store",
            "Storm may move " + component.id + " to another machine, which has no \"" + path + "\" of the first one",
            "name a Redis, or say in \"engine.storm.shared_folders\" that all machines have the folder in common");
  }
}

/// Whether a text has a URL with a password.
bool has_password(const std::string& text) {
  for (auto begin = text.find("://"); begin != std::string::npos; begin = text.find("://", begin + 3)) {
    const std::string word = text.substr(begin + 3, text.find_first_of(" \t\n", begin) - begin - 3);
    const auto at = word.find('@');
    if (at != std::string::npos && word.substr(0, at).find(':') != std::string::npos) return true;
  }
  return false;
}

/// Whether a setting of this name has a secret, and not the place of one.
bool names_secret(std::string name) {
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::tolower(c); });
  const auto has = [&](const char* word) { return name.find(word) != std::string::npos; };
  return (has("password") || has("passwd") || has("secret")) && !name.ends_with("file") && !name.ends_with("path");
}

/// What goes word for word into Storm's configuration of the topology, which all users of the cluster can read.
void check_secrets_of_storm(const TopologyDefinition& definition) {
  const StormSettings& storm = definition.storm;
  const auto section = [&] { return YamlSection(definition.root).require_section("engine").require_section("storm"); };
  const std::string problem = "the password would be in Storm's configuration, which all users of the cluster can read";
  const std::string remedy = "put it into a file on the machines of the cluster";
  for (const auto& [key, value] : storm.conf) {
    if (names_secret(key) || has_password(value)) section().require_section("conf").refuse(key, problem, remedy);
  }
  std::istringstream options(storm.worker_options);
  for (std::string word; options >> word;) {
    if (!names_secret(word.substr(0, word.find('='))) && !has_password(word)) continue;
    section().refuse("worker_options", problem, remedy);
    return;
  }
}

/// Passwords in what every user of the cluster can read: the jar, and Storm's configuration of the topology.
void check_secrets(Check& check) {
  const std::string problem = "the password would be in the topology's jar, which all users of the cluster can read";
  const std::string remedy = "put it into a file on the machines of the cluster (\"password_file\")";
  for (const auto& [name, broker] : check.definition.brokers) {
    if (std::any_of(broker.urls.begin(), broker.urls.end(), has_password))
      YamlSection(check.definition.root).require_section("brokers").refuse(name, problem, remedy);
  }
  if (has_password(check.definition.registry.url)) check.definition.root.refuse("registry", problem, remedy);
  const auto check_conf = [&](YamlSection section, const Config& conf) {
    for (const auto& [key, value] : conf) {
      if (names_secret(key) || has_password(value)) section.require_section("conf").refuse(key, problem, remedy);
    }
  };
  check_conf(check.definition.root, check.definition.conf);
  for (const auto* group : {&check.definition.spouts, &check.definition.bolts}) {
    for (const auto& component : *group) check_conf(component.section, component.conf);
  }
  check_secrets_of_storm(check.definition);
}

/// Storm's time-out must be longer than bolts keep tuples, or every one of them fails.
void check_holds(Check& check) {
  const auto timeout = std::chrono::ceil<seconds>(check.definition.runtime.message_timeout);
  if (timeout != check.definition.runtime.message_timeout) {
    check.notes.push_back("runtime.message_timeout: Storm counts whole seconds, so it is " + text_of(timeout));
  }
  if (!check.definition.runtime.acking) return;
  std::map<std::string, microseconds> held;  // longest, by component
  for (const auto& component : check.topology.components) {
    microseconds before{0};
    for (const auto& input : component.inputs) before = std::max(before, held[input.from]);
    const bool for_a_time = component.holds.count() > 0 && component.holds != Bolt::until_others_come;
    held[component.id] = before + (for_a_time ? component.holds : microseconds(0));
    if (!for_a_time || held[component.id] < timeout) continue;
    refuse(check, component.id, "class",
           fmt::format("tuples are kept for {}, and runtime.message_timeout is {}, so each of them would fail",
                       text_of(held[component.id]), text_of(timeout)),
           "set \"runtime.message_timeout\" to twice " + text_of(held[component.id]) + ", or make the window shorter");
  }
}

/// Keys that mean something to our workers only.
void note_without_meaning(Check& check) {
  const auto note = [&](bool given, const char* text) {
    if (given) check.notes.emplace_back(text);
  };
  note(check.definition.runtime.threads > 0, "runtime.threads: Storm has a thread for each executor");
  note(!check.definition.order_keys.empty(),
       "orders.trusted_keys: orders go to Storm's Nimbus, which has rights of its own");
}

}  // namespace

std::vector<std::string> check_limits(const TopologyDefinition& definition, const Topology& topology) {
  Check check{definition, topology, {}};
  definition.root.all_errors([&] {
    for (const auto part : {check_name, check_endpoints, check_streams, check_double_inputs, check_scope, check_state,
                            check_secrets, check_holds, note_without_meaning}) {
      part(check);
    }
  });
  return std::move(check.notes);
}

}  // namespace iotcloud::topology::storm
