#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <thread>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/topology/storm/job/jar.h>
#include <iotcloud/topology/storm/nimbus/nimbus_client.h>
#include <iotcloud/topology/storm/storm_verbs.h>

namespace iotcloud::topology::storm {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using std::chrono::seconds;

constexpr std::chrono::milliseconds look_pause{200};
/// How long, after what was under way could be finished, a topology that is killed may still be listed.
constexpr seconds kill_margin{120};
/// Components are opened only after their executors have told Nimbus of themselves; one that cannot be opened shows
/// within this time.
constexpr seconds after_reports{2};

/// Prints rows of the same keys, as a table or as JSON.
void print(const StormCall& call, const std::vector<std::string>& keys, const Json& rows) {
  if (call.json) {
    fmt::print("{}\n", rows.dump(2, ' ', false, Json::error_handler_t::replace));
    return;
  }
  const auto text = [](const Json& value) { return value.is_string() ? value.get<std::string>() : value.dump(); };
  std::vector<std::size_t> widths;
  for (const auto& key : keys) {
    widths.push_back(key.size());
    for (const auto& row : rows) widths.back() = std::max(widths.back(), text(row.at(key)).size());
  }
  const auto line = [&](const auto& cell_of) {
    std::string cells;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      const std::string cell = cell_of(keys[i]);
      cells += i + 1 == keys.size() ? cell : fmt::format("{:<{}}  ", cell, widths[i]);
    }
    fmt::print("{}\n", cells);
  };
  line([](const std::string& key) { return key; });
  for (const auto& row : rows) line([&](const std::string& key) { return text(row.at(key)); });
}

void note(const std::string& text) {
  std::fprintf(stderr, "iotcloud-storm: %s\n", text.c_str());
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

std::string time_text(std::int64_t at_s) {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(static_cast<std::time_t>(at_s)));
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

/// Shows the progress of sending on a terminal.
void show_progress(std::size_t sent, std::size_t whole) {
  if (isatty(STDERR_FILENO) == 0) return;
  std::fprintf(stderr, "\rsent %zu of %zu KiB%s", sent / 1024, whole / 1024, sent == whole ? "\n" : "");
}

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
/// says is about the workers that are to run, and not those of before. \throws NimbusError that says why they do not
/// run, for one when a component reports an error that is not among those `of_before`.
TopologyDetails wait_until_running(NimbusClient& nimbus, const std::string& name, const std::string& done,
                                   seconds limit, const std::vector<ReportedError>& of_before,
                                   const std::function<bool(const TopologyDetails&)>& goes_on) {
  const auto end = std::chrono::steady_clock::now() + limit;
  auto all_reported = std::chrono::steady_clock::time_point::max();
  while (true) {
    TopologyDetails details = details_of(nimbus, name);
    const auto first = std::find_if(details.errors.rbegin(), details.errors.rend(), [&](const ReportedError& error) {
      return std::find(of_before.begin(), of_before.end(), error) == of_before.end();
    });
    if (first != details.errors.rend()) {
      throw NimbusError(
          fmt::format("{} does not run: its component {} says: {} ({}:{}); `iotcloud-storm kill {}` ends it", name,
                      first->component, first->text, first->host, first->port, name));
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

std::size_t workers_of(const TopologyDetails& details) {
  std::set<std::pair<std::string, int>> workers;
  for (const auto& executor : details.executors) workers.emplace(executor.host, executor.port);
  return workers.size();
}

}  // namespace

int pack(const StormCall& call, const std::string& file, const std::string& jar, const std::string& onto) {
  const bool library = fs::path(file).extension() == ".so";
  const Job job = library ? make_library_job(file) : checked_job(call, file);
  tell_contents(write_jar(job, ShimFiles::find(), jar, onto));
  fmt::print(
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
  NimbusClient nimbus(call.nimbus.empty() ? job.nimbus : call.nimbus, call.patience);
  if (nimbus.version() != tested_version) {
    note(fmt::format("Nimbus {} is of Storm {}; this was tested with {}", nimbus.leader(), nimbus.version(),
                     tested_version));
  }
  const TemporaryJar jar;
  tell_contents(write_jar(job, ShimFiles::find(), jar.path()));
  nimbus.submit(job.name, job.conf, job.topology, jar.path(), show_progress);
  if (limit.count() == 0) {
    fmt::print("{} was submitted to {}\n", job.name, nimbus.leader());
    return 0;
  }
  const TopologyDetails details =
      wait_until_running(nimbus, job.name, "submitted", limit, {}, [](const TopologyDetails&) { return true; });
  fmt::print("{} runs: {} tasks in {} workers\n", job.name, tasks_of(details), workers_of(details));
  return 0;
}

int list(const StormCall& call) {
  auto nimbus = connect(call);
  Json rows = Json::array();
  for (const auto& topology : nimbus.topologies()) {
    rows.push_back({{"name", topology.name},
                    {"state", topology.status},
                    {"workers", topology.workers},
                    {"executors", topology.executors},
                    {"tasks", topology.tasks},
                    {"uptime_s", topology.uptime_s}});
  }
  print(call, {"name", "state", "workers", "executors", "tasks", "uptime_s"}, rows);
  return 0;
}

int show(const StormCall& call, const std::string& name) {
  auto nimbus = connect(call);
  Json rows = Json::array();
  for (const auto& executor : details_of(nimbus, name).executors) {
    rows.push_back({{"component", executor.component},
                    {"tasks", executor.first_task == executor.last_task
                                  ? std::to_string(executor.first_task)
                                  : fmt::format("{}-{}", executor.first_task, executor.last_task)},
                    {"worker", fmt::format("{}:{}", executor.host, executor.port)},
                    {"runs", executor.reported},
                    {"uptime_s", executor.uptime_s}});
  }
  print(call, {"component", "tasks", "worker", "runs", "uptime_s"}, rows);
  return 0;
}

int metrics(const StormCall& call, const std::string& name, const std::string& window) {
  auto nimbus = connect(call);
  Json rows = Json::array();
  for (const auto& counts : nimbus.counts(name, window)) {
    const auto ms = [](double value) { return fmt::format("{:.3f}", value); };
    rows.push_back({{"component", counts.component},
                    {"executors", counts.executors},
                    {"tasks", counts.tasks},
                    {"emitted", counts.emitted},
                    {"transferred", counts.transferred},
                    {"executed", counts.executed},
                    {"acked", counts.acked},
                    {"failed", counts.failed},
                    {"execute_ms", ms(counts.execute_ms)},
                    {"process_ms", ms(counts.process_ms)},
                    {"complete_ms", ms(counts.complete_ms)},
                    {"capacity", ms(counts.capacity)}});
  }
  print(call,
        {"component", "executors", "tasks", "emitted", "transferred", "executed", "acked", "failed", "execute_ms",
         "process_ms", "complete_ms", "capacity"},
        rows);
  return 0;
}

int errors(const StormCall& call, const std::string& name) {
  auto nimbus = connect(call);
  Json rows = Json::array();
  for (const auto& error : details_of(nimbus, name).errors) {
    rows.push_back({{"time", time_text(error.at_s)},
                    {"component", error.component},
                    {"worker", fmt::format("{}:{}", error.host, error.port)},
                    {"error", error.text}});
  }
  print(call, {"time", "component", "worker", "error"}, rows);
  return 0;
}

int set_active(const StormCall& call, const std::string& name, bool active) {
  auto nimbus = connect(call);
  active ? nimbus.activate(name) : nimbus.deactivate(name);
  fmt::print("{} is {}\n", name, active ? "active" : "inactive");
  return 0;
}

int rebalance(const StormCall& call, const std::string& name, std::optional<int> workers,
              const std::map<std::string, int>& executors, seconds wait, seconds limit) {
  auto nimbus = connect(call);
  const TopologyDetails before = details_of(nimbus, name);
  const auto began = std::chrono::steady_clock::now();
  nimbus.rebalance(name, workers, executors, wait);
  if (limit.count() == 0) {
    fmt::print("{} is rebalanced in {} s\n", name, wait.count());
    return 0;
  }
  const Placement placement = placement_of(before);
  const TopologyDetails details = wait_until_running(
      nimbus, name, "told to rebalance", wait + limit, before.errors, [&](const TopologyDetails& now) {
        const auto passed = std::chrono::steady_clock::now() - began;
        return is_of_new_workers(now, placement, std::chrono::duration_cast<seconds>(passed));
      });
  if (workers && workers_of(details) != static_cast<std::size_t>(*workers))
    note(fmt::format("it has {} workers and not {}: are there free slots, and as many executors?", workers_of(details),
                     *workers));
  fmt::print("{} runs: {} tasks in {} workers\n", name, tasks_of(details), workers_of(details));
  return 0;
}

int set_log_levels(const StormCall& call, const std::string& name, const std::map<std::string, std::string>& levels,
                   seconds time_out) {
  auto nimbus = connect(call);
  nimbus.set_log_levels(name, levels, time_out);
  for (const auto& [logger, level] : levels) {
    fmt::print("{}: the workers' logger {} has {}{}\n", name, logger, level.empty() ? "its level of before" : level,
               time_out.count() == 0 ? "" : fmt::format(" for {} s", time_out.count()));
  }
  return 0;
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
  fmt::print("{} was killed\n", name);
  return 0;
}

}  // namespace iotcloud::topology::storm
