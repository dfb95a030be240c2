#include <algorithm>
#include <cstring>
#include <filesystem>
#include <optional>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/topology/submission.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;

namespace {

/// The last line of what a program has written.
std::string last_line(std::string text) {
  while (text.ends_with('\n')) text.pop_back();
  return text.substr(text.rfind('\n') + 1);
}

/// The key of the file that gives the topology to Storm; nullopt: none does.
std::optional<config::YamlSection> storm_key(const std::string& file) {
  auto engine = config::YamlSection::load_file(file).optional_section("engine");
  if (!engine || !engine->has("storm")) return std::nullopt;
  return engine;
}

/// Refuses a file for the pools that gives the topology to Storm.
void refuse_storms(const std::string& file) {
  if (const auto engine = storm_key(file))
    throw engine->error(
        "storm", "the file gives the topology to Apache Storm, and not to pools of workers",
        "remove this key if pools are to run it. On Storm a topology is submitted (`iotcloud topology "
        "submit`, with --engine storm or none); another version is submitted after `iotcloud topology kill`");
}

}  // namespace

std::string engine_for(const std::string& file, const std::string& given) {
  if (given == "pool") refuse_storms(file);
  if (!given.empty()) return given;
  return storm_key(file) ? "storm" : "pool";
}

CheckedTopology check_file(const std::string& file) {
  refuse_storms(file);
  CheckedTopology checked;
  checked.yaml = bytes_of(file);
  const auto ended = run_sibling("iotcloud-topology", {"--check-submission", std::filesystem::absolute(file)});
  if (ended.signal != 0)
    throw config::Error(fmt::format("{}: its check crashed ({}): does a component library do so when it is loaded?",
                                    file, strsignal(ended.signal)));
  try {
    const auto answer = Json::parse(last_line(ended.output));
    if (answer.contains("error")) throw config::Error(answer.at("error").get<std::string>());
    checked.name = discovery::TopologyName(answer.at("topology").get<std::string>());
    checked.crossings = answer.at("crossings").get<std::string>();
    for (const auto& library : answer.at("libraries"))
      checked.libraries.push_back({library.at("name").get<std::string>(), library.at("path").get<std::string>()});
  } catch (const Json::exception&) {
    throw config::Error(fmt::format("iotcloud-topology --check-submission {} did not say what is in it: {}", file,
                                    last_line(ended.output)));
  }
  return checked;
}

void check_workers(const CheckedTopology& topology, int workers) {
  if (workers <= 1 || topology.crossings.empty()) return;
  throw config::Error(fmt::format(
      "topology {} cannot have {} workers of a pool: these inputs reach across drivers, of which each worker would "
      "have "
      "only its share, and nothing of ours carries tuples from worker to worker:\n{}Run it on Apache Storm, which "
      "does (docs/storm.md): iotcloud topology submit --engine storm; or with one worker; or, if each worker should "
      "process its share only, give these bolts \"scope: worker\"",
      topology.name, workers, topology.crossings));
}

void prepare(SubmitRequest& request, const std::string& file, MasterClient& master, std::ostream* terminal,
             std::vector<InstanceOutcome>& failures) {
  const auto checked = check_file(file);
  int workers = request.workers;
  if (workers == 0) {
    for (const auto& topology : master.topologies()) {
      if (topology.record.name == checked.name) workers = topology.wanted_workers;
    }
  }
  check_workers(checked, workers);
  request.topology = checked.name;
  request.yaml = checked.yaml;
  for (const auto& library : checked.libraries) {
    auto sent = send_library(library.path, master, terminal);
    request.libraries.push_back({library.name, sent.file, sent.sha256});
    failures.insert(failures.end(), sent.failures.begin(), sent.failures.end());
  }
}

OrderResult give(const SubmitRequest& request, bool update, MasterClient& master) {
  const std::string json = discovery::to_text(discovery::to_json<Json>(request));
  if (!update) return master.give("submitTopology", json, request.wait, 2);
  return master.give("updateTopology", json, request.wait, steps_of(request.topology, master, request.workers));
}

std::size_t steps_of(const discovery::TopologyName& topology, MasterClient& master, int workers) {
  for (const auto& one : master.topologies()) {
    if (one.record.name == topology) workers = std::max(workers, one.wanted_workers);
  }
  return 2 * static_cast<std::size_t>(std::max(workers, 1)) + 1;
}

}  // namespace iotcloud::master::cli
