#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <ostream>
#include <set>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/config/output/watch.h>
#include <iotcloud/discovery/name_taken.h>
#include <iotcloud/topology/storm/job/jar.h>
#include <iotcloud/topology/storm/nimbus/nimbus_client.h>
#include <iotcloud/topology/storm/storm_verbs.h>

namespace iotcloud::topology::storm {

namespace {

namespace fs = std::filesystem;
namespace output = config::output;
using output::Format;
using output::printable;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;
using std::chrono::seconds;

/// The window of Storm's counts from a topology's beginning on.
constexpr const char* all_time = ":all-time";
constexpr std::chrono::milliseconds look_pause{200};
/// How long the registry may take to say who runs.
constexpr std::chrono::milliseconds registry_limit{5000};
/// How long, after what was under way could be finished, a topology that is killed may still be listed.
constexpr seconds kill_margin{120};
/// Components are opened only after their executors have told Nimbus of themselves; one that cannot be opened shows
/// within this time.
constexpr seconds after_reports{2};

/// Prints a text for people, or what it says as data, under the keys of an order's answer.
int print_done(const StormCall& call, const std::string& text, Json outcomes = Json::array()) {
  if (call.format == Format::table) {
    call.out << text << '\n';
  } else {
    output::print_data(call.out, call.format, {{"ok", true}, {"text", text}, {"outcomes", std::move(outcomes)}});
  }
  return 0;
}

void note(const std::string& text) {
  std::fprintf(stderr, "iotcloud-storm: %s\n", text.c_str());
}

/// Refuses a topology that workers of ours run under the same name. When the registry does not tell, it notes so: then
/// the groups of readers see to it that only one of the two reads.
void refuse_taken_name(const Job& job) {
  if (job.registry.url.empty()) return;  // nothing of it reads what others read, too
  const auto unknown = [&](const std::string& why) {
    note(fmt::format("whether workers of ours run a topology {}, too, is not known: {}", job.name, why));
  };
  if (!job.registry.user.empty())
    return unknown("the registry has users, and the password of \"" + job.registry.user + "\" is for Storm's machines");
  std::string taken;
  try {
    auto options = job.registry;
    options.operation_timeout = registry_limit;
    taken = discovery::taken_by_workers(*discovery::make_registry(options), discovery::Paths(job.zk_root),
                                        discovery::TopologyName(job.name));
  } catch (const config::Error& error) {
    return unknown(error.what());
  }
  if (!taken.empty()) throw config::Error(taken);
}

NimbusClient connect(const StormCall& call) {
  return NimbusClient(call.nimbus, call.patience);
}

TopologyDetails details_of(NimbusClient& nimbus, const std::string& name) {
  auto details = nimbus.details(name);
  if (details) return *std::move(details);
  std::string known;
  for (const auto& topology : nimbus.topologies()) known += (known.empty() ? "" : ", ") + topology.name;
  throw NimbusError("no topology \"" + name + "\" runs; " + (known.empty() ? "none does" : "there are " + known));
}

/// The words of `iotcloud topology` for Storm's: "active", "inactive", "killed", "rebalancing".
std::string state_of(const RunningTopology& topology) {
  std::string state = topology.status;
  for (char& letter : state) letter = static_cast<char>(std::tolower(static_cast<unsigned char>(letter)));
  return state;
}

std::string place_of(const std::string& host, int port) {
  return fmt::format("{}:{}", host, port);
}

Job checked_job(const StormCall& call, const std::string& file) {
  Job job = make_job(file, call.folders);
  for (const auto& text : job.notes) note(text);
  return job;
}

void tell_contents(const JarContents& contents) {
  std::string taken;
  for (const auto& path : contents.taken) taken += (taken.empty() ? "" : ", ") + fs::path(path).filename().string();
  std::string expected;
  for (const auto& name : contents.expected) expected += (expected.empty() ? "" : ", ") + name;
  note("the jar has, beside the component libraries: " + (taken.empty() ? "nothing" : taken));
  note("expected on the workers' machines: " + expected);
}

/// A jar that lives as long as this object.
class TemporaryJar {
 public:
  TemporaryJar() {
    std::string name = fs::temp_directory_path() / "iotcloud-storm-XXXXXX";
    if (mkdtemp(name.data()) == nullptr)
      throw config::Error("no folder can be made in " + fs::temp_directory_path().string());
    folder_ = name;
  }
  ~TemporaryJar() {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }
  TemporaryJar(const TemporaryJar&) = delete;
  TemporaryJar& operator=(const TemporaryJar&) = delete;
  std::string path() const { return folder_ / "topology.jar"; }

 private:
  fs::path folder_;
};

/// Shows the progress of sending: on a terminal in one line, elsewhere by a line for each quarter.
class Progress {
 public:
  void operator()(std::size_t sent, std::size_t whole) {
    const std::string text = fmt::format("sent {} of {} KiB", sent / 1024, whole / 1024);
    if (isatty(STDERR_FILENO) != 0) {
      std::fprintf(stderr, "\r%s%s", text.c_str(), sent == whole ? "\n" : "");
    } else if (const auto quarter = 4 * sent / whole; quarter != std::exchange(quarter_, quarter) && quarter > 0) {
      note(text);
    }
  }

 private:
  std::size_t quarter_ = 0;  ///< the last; less when it is sent again
};

std::string not_running(const TopologyDetails& details) {
  std::set<std::string> waiting;
  for (const auto& executor : details.executors) {
    if (!executor.reported) waiting.insert(executor.component);
  }
  if (details.executors.empty())
    return "Nimbus has given it to no worker; are there free slots? (`show` has the workers)";
  std::string names;
  for (const auto& component : waiting) names += (names.empty() ? "" : ", ") + component;
  return "tasks of " + names + " do not run yet";
}

bool all_report(const TopologyDetails& details) {
  return !details.executors.empty() && std::all_of(details.executors.begin(), details.executors.end(),
                                                   [](const RunningExecutor& executor) { return executor.reported; });
}

/// Waits until all tasks run. \param done what the topology was told, for messages. \param goes_on whether what Nimbus
/// says is about the workers that are to run, and not those of before. A component that failed a tuple runs: that is
/// noted, once, unless it is among the errors `of_before`. \throws NimbusError that says why they do not run, for one
/// when the error of another one ended its worker.
TopologyDetails wait_until_running(NimbusClient& nimbus, const std::string& name, const std::string& done,
                                   seconds limit, const std::vector<ReportedError>& of_before,
                                   const std::function<bool(const TopologyDetails&)>& goes_on) {
  const auto end = std::chrono::steady_clock::now() + limit;
  auto all_reported = std::chrono::steady_clock::time_point::max();
  std::set<std::string> noted;
  while (true) {
    TopologyDetails details = details_of(nimbus, name);
    for (auto error = details.errors.rbegin(); error != details.errors.rend(); ++error) {  // the oldest first
      if (std::find(of_before.begin(), of_before.end(), *error) != of_before.end()) continue;
      const std::string says =
          fmt::format("its component {} says: {} ({}:{})", error->component, error->text, error->host, error->port);
      if (!error->of_tuple)
        throw NimbusError(fmt::format("{} does not run: {}; `iotcloud-storm kill {}` ends it", name, says, name));
      if (noted.insert(error->component).second)
        note(fmt::format("{}, and goes on; `iotcloud-storm errors {}` has all", says, name));
    }
    const auto now = std::chrono::steady_clock::now();
    const bool running = goes_on(details) && all_report(details);
    all_reported = running ? std::min(all_reported, now) : std::chrono::steady_clock::time_point::max();
    if (running && now - all_reported >= after_reports) return details;
    if (now >= end) {
      throw NimbusError(
          fmt::format("{} was {}, but not all of it ran within {} s: {}", name, done, limit.count(),
                      goes_on(details) ? not_running(details) : "Nimbus has not changed its workers yet"));
    }
    std::this_thread::sleep_for(look_pause);
  }
}

/// The executors of each worker (host and port), by their first tasks.
using Placement = std::map<std::pair<std::string, int>, std::set<int>>;

Placement placement_of(const TopologyDetails& details) {
  Placement placement;
  for (const auto& executor : details.executors) placement[{executor.host, executor.port}].insert(executor.first_task);
  return placement;
}

/// Whether what Nimbus says of executors is of the workers since a rebalance, `passed` ago: a worker whose executors
/// are others than before is a new process, and Nimbus may still have the last report of the old one.
bool is_of_new_workers(const TopologyDetails& details, const Placement& before, seconds passed) {
  if (details.topology.status == "REBALANCING") return false;
  const Placement now = placement_of(details);
  return std::all_of(details.executors.begin(), details.executors.end(), [&](const RunningExecutor& executor) {
    const auto worker = std::make_pair(executor.host, executor.port);
    const auto was = before.find(worker);
    const bool is_kept = was != before.end() && was->second == now.at(worker);
    return is_kept || executor.uptime_s <= passed.count();
  });
}

/// The tasks of its own components, without Storm's.
int tasks_of(const TopologyDetails& details) {
  int tasks = 0;
  for (const auto& executor : details.executors) tasks += executor.last_task - executor.first_task + 1;
  return tasks;
}

/// A worker of Storm, and the tasks of a topology's own components in it.
struct SlotWorker {
  std::string host;
  int tasks = 0;
  int uptime_s = 0;
};

/// By host and port.
std::map<std::string, SlotWorker> workers_of(const TopologyDetails& details) {
  std::map<std::string, SlotWorker> workers;
  for (const auto& executor : details.executors) {
    SlotWorker& worker = workers[place_of(executor.host, executor.port)];
    worker.host = executor.host;
    worker.tasks += executor.last_task - executor.first_task + 1;
    worker.uptime_s = std::max(worker.uptime_s, executor.uptime_s);
  }
  return workers;
}

/// Prints that a topology's tasks run.
int print_running(const StormCall& call, const std::string& name, const TopologyDetails& details) {
  const auto workers = workers_of(details);
  Json outcomes = Json::array();
  for (const auto& [place, worker] : workers) {
    outcomes.push_back({{"worker", place},
                        {"host", worker.host},
                        {"outcome", "done"},
                        {"reason", fmt::format("{} tasks", worker.tasks)}});
  }
  return print_done(call, fmt::format("{} runs: {} tasks in {} workers", name, tasks_of(details), workers.size()),
                    std::move(outcomes));
}

std::size_t errors_of(const TopologyDetails& details, const std::string& component) {
  return static_cast<std::size_t>(
      std::count_if(details.errors.begin(), details.errors.end(),
                    [&](const ReportedError& error) { return error.component == component; }));
}

/// What a component did, under the keys of our own workers' pages. Storm has means of durations only.
Json sum_of(const ComponentCounts& counts, const TopologyDetails& details) {
  constexpr double us = 1000;
  return {{"parallelism", counts.executors},
          {"tasks", counts.tasks},
          {"emitted", counts.emitted},
          {"transferred", counts.transferred},
          {"executed", counts.executed},
          {"acked", counts.acked},
          {"failed", counts.failed},
          {"errors", errors_of(details, counts.component)},
          {"capacity", counts.capacity},
          {"execute", {{"mean_us", counts.execute_ms * us}}},
          {"process", {{"mean_us", counts.process_ms * us}}},
          {"complete", {{"mean_us", counts.complete_ms * us}}},
          {"last_error", counts.last_error}};
}

std::string kind_of(const ComponentCounts& counts) {
  return counts.spout ? "spout" : "bolt";
}

/// "1.250ms"; "-": nothing was measured.
std::string duration(double ms) {
  return ms > 0 ? fmt::format("{:.3f}ms", ms) : "-";
}

void show_workers(const TopologyDetails& details, std::ostream& out) {
  Rows rows;
  for (const auto& [place, worker] : workers_of(details)) {
    rows.push_back({printable(place), printable(worker.host), std::to_string(worker.tasks), state_of(details.topology),
                    output::age(output::began_ms(seconds(worker.uptime_s)), output::now_ms())});
  }
  output::print_table(out, {"WORKER", "HOST", "TASKS", "STATE", "SINCE"}, rows);
}

void show_components(const std::vector<ComponentCounts>& all, const TopologyDetails& details, std::ostream& out) {
  Rows rows;
  for (const auto& counts : all) {
    rows.push_back({printable(counts.component), kind_of(counts), fmt::format("{}/{}", counts.executors, counts.tasks),
                    std::to_string(counts.emitted), std::to_string(counts.executed), std::to_string(counts.failed),
                    std::to_string(errors_of(details, counts.component)), printable(counts.last_error)});
  }
  output::print_table(
      out, {"COMPONENT", "KIND", "PARALLEL/TASKS", "EMITTED", "EXECUTED", "FAILED", "ERRORS", "LAST ERROR"}, rows);
}

std::string tasks_text(const RunningExecutor& executor) {
  return executor.first_task == executor.last_task ? std::to_string(executor.first_task)
                                                   : fmt::format("{}-{}", executor.first_task, executor.last_task);
}

void show_executors(const TopologyDetails& details, std::ostream& out) {
  Rows rows;
  for (const auto& executor : details.executors) {
    rows.push_back({printable(executor.component), tasks_text(executor),
                    printable(place_of(executor.host, executor.port)), executor.reported ? "yes" : "not yet",
                    output::age(output::began_ms(seconds(executor.uptime_s)), output::now_ms())});
  }
  output::print_table(out, {"COMPONENT", "TASKS", "WORKER", "RUNS", "SINCE"}, rows);
}

void print_counts(const std::vector<ComponentCounts>& all, std::ostream& out) {
  Rows rows;
  for (const auto& counts : all) {
    rows.push_back({printable(counts.component), fmt::format("{}/{}", counts.executors, counts.tasks),
                    std::to_string(counts.emitted), std::to_string(counts.transferred), std::to_string(counts.executed),
                    std::to_string(counts.acked), std::to_string(counts.failed), fmt::format("{:.2f}", counts.capacity),
                    duration(counts.execute_ms), duration(counts.process_ms), duration(counts.complete_ms),
                    printable(counts.last_error)});
  }
  output::print_table(out,
                      {"COMPONENT", "PARALLEL/TASKS", "EMITTED", "TRANSFERRED", "EXECUTED", "ACKED", "FAILED",
                       "CAPACITY", "EXECUTE mean", "PROCESS", "COMPLETE", "LAST ERROR"},
                      rows);
}

int list_once(const StormCall& call, NimbusClient& nimbus) {
  Rows rows;
  Json json = Json::array();
  for (const auto& topology : nimbus.topologies()) {
    const auto details = nimbus.details(topology.name);
    if (!details) continue;  // it ended since
    std::vector<std::string> workers, spouts, bolts;
    for (const auto& [place, worker] : workers_of(*details)) workers.push_back(place);
    try {
      for (const auto& counts : nimbus.counts(topology.name, all_time))
        (counts.spout ? spouts : bolts).push_back(counts.component);
    } catch (const NimbusError&) {
      if (nimbus.details(topology.name)) throw;
      continue;  // it ended since
    }
    const auto since = output::began_ms(seconds(topology.uptime_s));
    rows.push_back({printable(topology.name), state_of(topology), std::to_string(topology.workers),
                    output::age(since, output::now_ms()), printable(fmt::format("{}", fmt::join(spouts, ","))),
                    printable(fmt::format("{}", fmt::join(bolts, ",")))});
    json.push_back({{"topology", topology.name},
                    {"engine", "storm"},
                    {"state", state_of(topology)},
                    {"workers", workers},
                    {"spouts", spouts},
                    {"bolts", bolts},
                    {"since_ms", since}});
  }
  output::print(call.out, call.format, {"TOPOLOGY", "STATE", "WORKERS", "SINCE", "SPOUTS", "BOLTS"}, rows, json);
  return 0;
}

}  // namespace

int pack(const StormCall& call, const std::string& file, const std::string& jar, const std::string& onto) {
  const bool library = fs::path(file).extension() == ".so";
  const Job job = library ? make_library_job(file) : checked_job(call, file);
  tell_contents(write_jar(job, ShimFiles::find(), jar, onto));
  call.out << fmt::format(
      "{}: submit it with `storm jar {}{}\n", jar, jar,
      library ? " CLASS ...`, where CLASS is your main class, or that of Flux, org.apache.storm.flux.Flux" : "`");
  return 0;
}

int submit(const StormCall& call, const std::string& file, std::optional<int> workers, seconds limit) {
  Job job = checked_job(call, file);
  if (workers) {
    Json conf = Json::parse(job.conf);
    conf["topology.workers"] = *workers;
    job.conf = conf.dump();
  }
  refuse_taken_name(job);
  NimbusClient nimbus(call.nimbus.empty() ? job.nimbus : call.nimbus, call.patience);
  if (nimbus.version() != tested_version) {
    note(fmt::format("Nimbus {} is of Storm {}; this was tested with {}", nimbus.leader(), nimbus.version(),
                     tested_version));
  }
  const TemporaryJar jar;
  tell_contents(write_jar(job, ShimFiles::find(), jar.path()));
  nimbus.submit(job.name, job.conf, job.topology, jar.path(), Progress());
  if (limit.count() == 0) return print_done(call, fmt::format("{} was submitted to {}", job.name, nimbus.leader()));
  const TopologyDetails details =
      wait_until_running(nimbus, job.name, "submitted", limit, {}, [](const TopologyDetails&) { return true; });
  return print_running(call, job.name, details);
}

int list(const StormCall& call, double watch) {
  auto nimbus = connect(call);
  return output::watch(call.out, call.format, watch, [&] { return list_once(call, nimbus); });
}

int show(const StormCall& call, const std::string& name) {
  auto nimbus = connect(call);
  const TopologyDetails details = details_of(nimbus, name);
  const auto counts = nimbus.counts(name, all_time);
  const auto workers = workers_of(details);
  if (call.format == Format::table) {
    call.out << fmt::format("{}: {}, {} worker{} of Apache Storm\n\n", printable(name), state_of(details.topology),
                            workers.size(), workers.size() == 1 ? "" : "s");
    show_workers(details, call.out);
    call.out << '\n';
    show_components(counts, details, call.out);
    call.out << '\n';
    show_executors(details, call.out);
    return 0;
  }
  Json of_workers = Json::array(), components = Json::array(), executors = Json::array();
  for (const auto& [place, worker] : workers) {
    of_workers.push_back({{"worker", place},
                          {"host", worker.host},
                          {"state", state_of(details.topology)},
                          {"since_ms", output::began_ms(seconds(worker.uptime_s))}});
  }
  for (const auto& each : counts) {
    Json component{{"id", each.component}, {"kind", kind_of(each)}};
    component.update(sum_of(each, details));
    components.push_back(std::move(component));
  }
  for (const auto& executor : details.executors) {
    executors.push_back({{"component", executor.component},
                         {"tasks", tasks_text(executor)},
                         {"worker", place_of(executor.host, executor.port)},
                         {"runs", executor.reported},
                         {"since_ms", output::began_ms(seconds(executor.uptime_s))}});
  }
  output::print_data(call.out, call.format,
                     {{"topology", name},
                      {"engine", "storm"},
                      {"state", state_of(details.topology)},
                      {"since_ms", output::began_ms(seconds(details.topology.uptime_s))},
                      {"wanted_workers", details.topology.workers},
                      {"workers", of_workers},
                      {"components", components},
                      {"executors", executors}});
  return 0;
}

int metrics(const StormCall& call, const std::string& name, const std::string& window, double watch) {
  auto nimbus = connect(call);
  return output::watch(call.out, call.format, watch, [&] {
    const auto counts = nimbus.counts(name, window);
    if (call.format == Format::table) {
      print_counts(counts, call.out);
      return 0;
    }
    const TopologyDetails details = details_of(nimbus, name);
    Json components = Json::array();
    for (const auto& each : counts) {
      components.push_back({{"component", each.component}, {"kind", kind_of(each)}, {"sum", sum_of(each, details)}});
    }
    const Json json{{"topology", name},
                    {"engine", "storm"},
                    {"window", window},
                    {"workers", workers_of(details).size()},
                    {"components", components}};
    if (watch > 0 && call.format == Format::json) {  // a line for each, as of our own workers
      call.out << json.dump(-1, ' ', false, Json::error_handler_t::replace) << '\n';
    } else {
      output::print_data(call.out, call.format, json);
    }
    return 0;
  });
}

int errors(const StormCall& call, const std::string& name) {
  auto nimbus = connect(call);
  Rows rows;
  Json json = Json::array();
  for (const auto& error : details_of(nimbus, name).errors) {
    const auto at_ms = std::int64_t{1000} * error.at_s;
    const std::string worker = place_of(error.host, error.port);
    rows.push_back({printable(error.component), printable(worker), output::moment(at_ms), printable(error.text)});
    json.push_back({{"component", error.component}, {"worker", worker}, {"time_ms", at_ms}, {"error", error.text}});
  }
  output::print(call.out, call.format, {"COMPONENT", "WORKER", "TIME", "ERROR"}, rows, json);
  return 0;
}

int set_active(const StormCall& call, const std::string& name, bool active) {
  auto nimbus = connect(call);
  active ? nimbus.activate(name) : nimbus.deactivate(name);
  return print_done(call, fmt::format("{} is {}", name, active ? "active" : "inactive"));
}

int rebalance(const StormCall& call, const std::string& name, std::optional<int> workers,
              const std::map<std::string, int>& executors, seconds wait, seconds limit) {
  auto nimbus = connect(call);
  const TopologyDetails before = details_of(nimbus, name);
  const auto began = std::chrono::steady_clock::now();
  nimbus.rebalance(name, workers, executors, wait);
  if (limit.count() == 0) return print_done(call, fmt::format("{} is rebalanced in {} s", name, wait.count()));
  const Placement placement = placement_of(before);
  const TopologyDetails details = wait_until_running(
      nimbus, name, "told to rebalance", wait + limit, before.errors, [&](const TopologyDetails& now) {
        const auto passed = std::chrono::steady_clock::now() - began;
        return is_of_new_workers(now, placement, std::chrono::duration_cast<seconds>(passed));
      });
  if (const auto has = workers_of(details).size(); workers && has != static_cast<std::size_t>(*workers))
    note(fmt::format("it has {} workers and not {}: are there free slots, and as many executors?", has, *workers));
  return print_running(call, name, details);
}

int set_log_levels(const StormCall& call, const std::string& name, const std::map<std::string, std::string>& levels,
                   seconds time_out) {
  auto nimbus = connect(call);
  nimbus.set_log_levels(name, levels, time_out);
  std::vector<std::string> changed;
  changed.reserve(levels.size());
  for (const auto& [logger, level] : levels) {
    changed.push_back(fmt::format("{}: the workers' logger {} has {}{}", name, logger,
                                  level.empty() ? "its level of before" : level,
                                  time_out.count() == 0 ? "" : fmt::format(" for {} s", time_out.count())));
  }
  return print_done(call, fmt::format("{}", fmt::join(changed, "\n")));
}

int kill(const StormCall& call, const std::string& name, seconds wait) {
  auto nimbus = connect(call);
  const auto killed = nimbus.details(name);
  nimbus.kill(name, wait);
  const auto end = std::chrono::steady_clock::now() + wait + kill_margin;
  const auto is_there = [&] {
    const auto now = nimbus.details(name);
    return now && killed && now->topology.id == killed->topology.id;  // not another one that has its name since
  };
  while (is_there()) {
    if (std::chrono::steady_clock::now() >= end) {
      throw NimbusError(fmt::format("{} was told to end, and is still there {} s later: see Nimbus' log", name,
                                    (wait + kill_margin).count()));
    }
    std::this_thread::sleep_for(look_pause);
  }
  return print_done(call, fmt::format("{} was killed", name));
}

}  // namespace iotcloud::topology::storm
