#include <cerrno>
#include <cstring>
#include <filesystem>
#include <ostream>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/topology/topology_command.h>
#include <iotcloud/master/cli/topology/topology_pages.h>
#include <iotcloud/master/cli/topology/topology_tap.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

std::int64_t now_ms() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(system_clock::now().time_since_epoch()).count();
}

/// \throws Failed naming those that there are.
wire::TTopology find_topology(const std::string& name, MasterClient& master) {
  std::vector<std::string> names;
  for (const auto& topology : master.topologies()) {
    if (topology.name == name) return topology;
    names.push_back(topology.name);
  }
  throw Failed(names.empty() ? fmt::format("no topology \"{}\"; none runs", name)
                             : fmt::format("no topology \"{}\"; there are {}", name, fmt::join(names, ", ")));
}

wire::TTopologyChange::type change_of(Verb verb) {
  switch (verb) {
    case Verb::topology_deactivate:
      return wire::TTopologyChange::DEACTIVATE;
    case Verb::topology_rebalance:
      return wire::TTopologyChange::REBALANCE;
    case Verb::topology_kill:
      return wire::TTopologyChange::KILL;
    default:
      return wire::TTopologyChange::ACTIVATE;
  }
}

int order(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  wire::TTopologyRequest request;
  request.__set_topology(command.topology);
  request.__set_change(change_of(command.verb));
  request.__set_drainMs(command.drain_ms);
  request.__set_waitMs(command.wait_ms);
  for (const auto& [component, parallelism] : command.parallelism) request.parallelism[component] = parallelism;
  const auto answer = master.order(request);
  const bool ok = answer.response.state == discovery::wire::TResponseState::SUCCESS;
  if (command.format != Format::table) {
    Json outcomes = Json::array();
    for (const auto& outcome : answer.outcomes)
      outcomes.push_back({{"worker", outcome.worker},
                          {"host", outcome.host},
                          {"outcome", word(outcome.outcome)},
                          {"reason", outcome.reason}});
    print_data(out, command.format, {{"ok", ok}, {"text", answer.response.statusMessage}, {"outcomes", outcomes}});
    return ok ? exit_ok : exit_failed;
  }
  if (answer.refusal != wire::TRefusal::NONE) {
    err << "iotcloud: " << printable(answer.response.statusMessage) << '\n';
    return exit_failed;
  }
  Rows rows;
  for (const auto& outcome : answer.outcomes)
    rows.push_back(
        {printable(outcome.worker), printable(outcome.host), word(outcome.outcome), printable(outcome.reason)});
  if (!rows.empty()) print_table(out, {"WORKER", "HOST", "OUTCOME", "REASON"}, rows);
  if (!answer.text.empty()) out << printable(answer.text) << '\n';
  return ok ? exit_ok : exit_failed;
}

std::string inputs_of(const Json& component) {
  std::vector<std::string> inputs;
  for (const auto& input : component.at("inputs")) {
    const auto stream = input.at("stream").get<std::string>();
    std::string text = input.at("from").get<std::string>() + (stream == "default" ? "" : "/" + stream) + " " +
                       input.at("grouping").get<std::string>();
    if (!input.at("fields").empty())
      text += fmt::format("({})", fmt::join(input.at("fields").get<std::vector<std::string>>(), ","));
    inputs.push_back(std::move(text));
  }
  return fmt::format("{}", fmt::join(inputs, ", "));
}

std::string outputs_of(const Json& component) {
  std::vector<std::string> outputs;
  for (const auto& [stream, fields] : component.at("streams").items()) {
    outputs.push_back((stream == "default" ? "" : stream + ": ") +
                      fmt::format("{}", fmt::join(fields.get<std::vector<std::string>>(), ",")));
  }
  return fmt::format("{}", fmt::join(outputs, "; "));
}

void show_workers(const wire::TTopology& topology, std::ostream& out) {
  Rows rows;
  for (const auto& worker : topology.workerRecords)
    rows.push_back({printable(worker.name), printable(worker.host), std::to_string(worker.pid), printable(worker.http),
                    printable(worker.state), std::to_string(worker.revision), age(worker.sinceMs, now_ms()),
                    printable(worker.error)});
  print_table(out, {"WORKER", "HOST", "PID", "PAGES", "STATE", "ORDER", "SINCE", "ERROR"}, rows);
}

void show_graph(const TopologyPages& pages, std::ostream& out) {
  Rows rows;
  for (const auto& component : pages.components()) {
    const auto id = component.at("id").get<std::string>();
    const Json sum = pages.sum(id);
    rows.push_back({printable(id), component.at("kind").get<std::string>(),
                    fmt::format("{}/{}", sum.at("parallelism").dump(), sum.at("tasks").dump()),
                    printable(inputs_of(component)), printable(outputs_of(component)), sum.at("emitted").dump(),
                    sum.at("executed").dump(), sum.at("failed").dump(), sum.at("errors").dump(),
                    printable(sum.at("last_error").get<std::string>())});
  }
  print_table(out,
              {"COMPONENT", "KIND", "PARALLEL/TASKS", "INPUTS", "FIELDS", "EMITTED", "EXECUTED", "FAILED", "ERRORS",
               "LAST ERROR"},
              rows);
}

Json to_json(const wire::TWorker& worker) {
  return {{"worker", worker.name}, {"host", worker.host},       {"pid", worker.pid},
          {"http", worker.http},   {"state", worker.state},     {"revision", worker.revision},
          {"error", worker.error}, {"since_ms", worker.sinceMs}};
}

/// What could not be read goes to `err`; what could is shown.
int complain(const TopologyPages& pages, std::ostream& err) {
  for (const auto& problem : pages.problems()) err << "iotcloud: " << printable(problem) << '\n';
  return pages.problems().empty() ? exit_ok : exit_failed;
}

int show(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  const auto topology = find_topology(command.topology, master);
  const TopologyPages pages(topology);
  if (command.format != Format::table) {
    Json workers = Json::array();
    for (const auto& worker : topology.workerRecords) workers.push_back(to_json(worker));
    Json components = Json::array();
    for (Json component : pages.components()) {
      component.update(pages.sum(component.at("id").get<std::string>()));
      components.push_back(std::move(component));
    }
    print_data(out, command.format,
               {{"topology", topology.name},
                {"state", topology_state(topology)},
                {"revision", topology.revision},
                {"since_ms", topology.sinceMs},
                {"workers", workers},
                {"components", components}});
    return complain(pages, err);
  }
  out << fmt::format("{}: {}, {} worker{}, {}\n\n", printable(topology.name), topology_state(topology),
                     topology.workers.size(), topology.workers.size() == 1 ? "" : "s",
                     topology.revision == 0 ? std::string("no orders") : fmt::format("order {}", topology.revision));
  show_workers(topology, out);
  if (!pages.components().empty()) {
    out << '\n';
    show_graph(pages, out);
  }
  return complain(pages, err);
}

int metrics(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  int status = exit_ok;
  do {
    const TopologyPages pages(find_topology(command.topology, master));
    if (command.format == Format::table) {
      if (command.watch_s > 0 && isatty(STDOUT_FILENO) == 1) out << "\033[H\033[2J";
      print_metrics(out, pages);
      if (command.watch_s > 0) out << '\n';
    } else if (command.watch_s > 0 && command.format == Format::json) {
      out << pages.metrics().dump(-1, ' ', false, Json::error_handler_t::replace) << '\n';
    } else {
      if (command.watch_s > 0) out << "---\n";
      print_data(out, command.format, pages.metrics());
    }
    out.flush();
    status = complain(pages, err);
  } while (command.watch_s > 0 && out && pause(std::chrono::duration<double>(command.watch_s)));
  return status;
}

}  // namespace

std::string topology_state(const wire::TTopology& topology) {
  std::set<std::string> states;
  for (const auto& worker : topology.workerRecords) states.insert(worker.state);
  if (states.empty()) return topology.wanted;
  return states.size() == 1 ? printable(*states.begin()) : "mixed";
}

const char* word(wire::TOutcome::type outcome) {
  switch (outcome) {
    case wire::TOutcome::DONE:
      return "done";
    case wire::TOutcome::FAILED:
      return "failed";
    case wire::TOutcome::PENDING:
      return "pending";
    case wire::TOutcome::UNKNOWN:
      return "unknown";
  }
  return "unknown";
}

int run_topology(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  switch (command.verb) {
    case Verb::topology_show:
      return show(command, master, out, err);
    case Verb::topology_metrics:
      return metrics(command, master, out, err);
    case Verb::topology_tap:
      return tap(command, find_topology(command.topology, master), out, err);
    default:
      return order(command, master, out, err);
  }
}

int check_topology(const Command& command, std::ostream& err) {
  std::error_code unknown;
  const auto program = std::filesystem::read_symlink("/proc/self/exe", unknown).parent_path() / "iotcloud-topology";
  const char* words[] = {program.c_str(), "--check", command.file.c_str(), nullptr};
  execv(program.c_str(), const_cast<char* const*>(words));
  err << fmt::format("iotcloud: {} cannot be run ({}); it checks topologies, and is installed beside this program\n",
                     program.string(), std::strerror(errno));
  return exit_failed;
}

}  // namespace iotcloud::master::cli
