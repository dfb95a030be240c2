// topology ...: orders by way of the master; numbers and samples from the workers' own pages, or by way of the master,
// too
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <optional>
#include <ostream>
#include <set>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/topology/engine_choice.h>
#include <iotcloud/master/cli/topology/pack_verb.h>
#include <iotcloud/master/cli/topology/topology_pages.h>
#include <iotcloud/master/cli/topology/topology_tap.h>
#include <iotcloud/master/cli/topology/topology_verbs.h>
#include <iotcloud/master/cli/watch.h>

namespace iotcloud::master::cli {

using discovery::TopologyStatus;
using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

/// \throws RequestFailed when there is no such topology, naming those that there are.
TopologyStatus find_topology(const discovery::TopologyName& name, MasterClient& master) {
  std::vector<discovery::TopologyName> names;
  for (auto& topology : master.topologies()) {
    if (topology.record.name == name) return std::move(topology);
    names.push_back(topology.record.name);
  }
  throw RequestFailed(names.empty() ? fmt::format("no topology \"{}\"; none runs", name)
                                    : fmt::format("no topology \"{}\"; there are {}", name, fmt::join(names, ", ")));
}

/// A verb about one topology.
class OfTopology : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override { options.add_option("TOPOLOGY", name_, "the topology")->required(); }

 protected:
  discovery::TopologyName name_;
};

/// A verb about one topology, also about one on Apache Storm.
class OfAnyTopology : public OfTopology {
 public:
  using OfTopology::OfTopology;
  void declare(CLI::App& options) override {
    OfTopology::declare(options);
    engine_.declare(options, "one of workers of ours");
  }
  void check() override { engine_.check(); }

 protected:
  EngineChoice engine_;
};

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

void show_workers(const TopologyStatus& topology, std::ostream& out) {
  Rows rows;
  for (const auto& worker : topology.workers)
    rows.push_back({printable(worker.name), printable(worker.host), std::to_string(worker.pid), printable(worker.http),
                    printable(worker.state), std::to_string(worker.revision), age(worker.since_ms, now_ms()),
                    printable(worker.error), printable(worker.trouble)});
  print_table(out, {"WORKER", "HOST", "PID", "PAGES", "STATE", "ORDER", "SINCE", "ERROR", "TROUBLE"}, rows);
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

Json worker_json(const discovery::WorkerRecord& worker) {
  return {{"worker", worker.name}, {"host", worker.host},         {"pid", worker.pid},
          {"http", worker.http},   {"state", worker.state},       {"revision", worker.revision},
          {"error", worker.error}, {"since_ms", worker.since_ms}, {"trouble", worker.trouble},
          {"tls", worker.tls}};
}

/// Prints to `err` why pages could not be read; the others are shown.
int complain(const TopologyPages& pages, std::ostream& err) {
  for (const auto& problem : pages.problems()) err << "iotcloud: " << printable(problem) << '\n';
  return pages.problems().empty() ? exit_ok : exit_failed;
}

class Show final : public OfAnyTopology {
 public:
  Show()
      : OfAnyTopology({"show", "Show one topology: its graph, workers, totals and errors",
                       "iotcloud topology show echo", Role::viewer}) {}

  int run(Call& call) override {
    if (engine_.storm()) engine_.become(call, {"show", name_});
    const auto master = call.connect();
    const auto topology = find_topology(name_, *master);
    WorkerPages asked(*master, name_);
    const TopologyPages pages(topology, asked);
    if (call.format == Format::table) {
      print_all(topology, pages, call.out);
    } else {
      Json workers = Json::array();
      for (const auto& worker : topology.workers) workers.push_back(worker_json(worker));
      Json components = Json::array();
      Json places = discovery::json_of<Json>(topology.places);
      for (Json component : pages.components()) {
        component.update(pages.sum(component.at("id").get<std::string>()));
        components.push_back(std::move(component));
      }
      print_data(call.out, call.format,
                 {{"topology", topology.record.name},
                  {"state", topology_state(topology)},
                  {"revision", revision_of(topology)},
                  {"since_ms", topology.record.since_ms},
                  {"version", topology.version},
                  {"wanted_workers", topology.wanted_workers},
                  {"places", places},
                  {"workers", workers},
                  {"brokers", pages.brokers()},
                  {"arrivals", pages.arrivals()},
                  {"troubles", pages.troubles()},
                  {"components", components}});
    }
    return complain(pages, call.err);
  }

 private:
  static void show_places(const TopologyStatus& topology, std::ostream& out) {
    if (topology.version == 0) return;
    Rows rows;
    for (const auto& place : topology.places) {
      rows.push_back({std::to_string(place.place), printable(place.pool), std::to_string(place.version),
                      printable(place.state), age(place.since_ms, now_ms()), printable(place.worker),
                      printable(place.reason)});
    }
    out << fmt::format("\nsubmitted: version {}, {} worker{}\n", topology.version, topology.wanted_workers,
                       topology.wanted_workers == 1 ? "" : "s");
    print_table(out, {"PLACE", "POOL", "VERSION", "STATE", "SINCE", "WORKER", "REASON"}, rows);
  }
  static void show_brokers(const TopologyPages& pages, std::ostream& out) {
    Rows rows;
    for (const Json& link : pages.brokers()) {
      rows.push_back({printable(link.at("worker").get<std::string>()), printable(link.at("broker").get<std::string>()),
                      printable(link.at("url").get<std::string>()), printable(link.at("state").get<std::string>()),
                      age(link.at("since_ms").get<std::int64_t>(), now_ms()),
                      printable(link.value("why", std::string()))});
    }
    if (rows.empty()) return;
    out << '\n';
    print_table(out, {"WORKER", "BROKER", "URL", "STATE", "SINCE", "WHY"}, rows);
  }
  static void show_arrivals(const TopologyPages& pages, std::ostream& out) {
    Rows rows;
    for (const Json& spout : pages.arrivals()) {
      const Json &seconds = spout.at("age_s"), &backlog = spout.at("backlog");
      const auto most = spout.at("most").get<std::uint64_t>();
      rows.push_back(
          {printable(spout.at("component").get<std::string>()), printable(spout.at("worker").get<std::string>()),
           seconds.is_null() ? "-" : fmt::format("{:.3f} s", seconds.get<double>()),
           backlog.is_null() ? "-" : std::to_string(backlog.get<std::uint64_t>()),
           most == 0 ? "-" : fmt::format("{} in {}", most, printable(spout.at("topic").get<std::string>()))});
    }
    if (rows.empty()) return;
    out << '\n';
    print_table(out, {"SPOUT", "WORKER", "AGE AT ARRIVAL", "WAITING AT BROKERS", "MOST"}, rows);
  }
  static void show_troubles(const TopologyPages& pages, std::ostream& out) {
    Rows rows;
    for (const Json& trouble : pages.troubles()) {
      rows.push_back({printable(trouble.at("component").get<std::string>()),
                      printable(trouble.at("worker").get<std::string>()),
                      printable(trouble.at("text").get<std::string>())});
    }
    if (rows.empty()) return;
    out << '\n';
    print_table(out, {"COMPONENT", "WORKER", "TROUBLE"}, rows);
  }
  static void print_all(const TopologyStatus& topology, const TopologyPages& pages, std::ostream& out) {
    const auto workers = topology.workers.size();
    const auto revision = revision_of(topology);
    out << fmt::format("{}: {}, {} worker{}, {}\n\n", printable(topology.record.name), topology_state(topology),
                       workers, workers == 1 ? "" : "s",
                       revision == 0 ? std::string("no orders") : fmt::format("order {}", revision));
    show_workers(topology, out);
    show_places(topology, out);
    show_brokers(pages, out);
    show_arrivals(pages, out);
    show_troubles(pages, out);
    if (pages.components().empty()) return;
    out << '\n';
    show_graph(pages, out);
  }
};

class Metrics final : public OfAnyTopology {
 public:
  Metrics()
      : OfAnyTopology({"metrics",
                       "Show what every component and task did. Of several tasks: sums; p50 of the one with the most "
                       "samples, p99 and max of the worst",
                       "iotcloud topology metrics echo --watch", Role::viewer}) {}

  void declare(CLI::App& options) override {
    OfAnyTopology::declare(options);
    watch_.declare(options);
    options.add_flag(
        "--rates", rates_,
        "measure for a second how much each component does; --watch always shows it. Not with Storm, whose "
        "workers report their counts once a minute or so");
    auto* window = options.add_option("--window", window_,
                                      "with Storm: the counts of the last 600, 10800 or 86400 seconds, or :all-time");
    engine_.for_storm(*window->check(CLI::IsMember({"600", "10800", "86400", ":all-time"}))->type_name("WINDOW"));
  }
  void check() override {
    OfAnyTopology::check();
    if (engine_.storm() && rates_)
      throw CLI::ValidationError("--rates", "Storm's workers report their counts once a minute or so: use --watch 60");
  }
  bool goes_on() const override { return watch_.on(); }

  int run(Call& call) override {
    if (engine_.storm()) {
      std::vector<std::string> words{"metrics", name_};
      if (!window_.empty()) words.insert(words.end(), {"--window", window_});
      engine_.become(call, watch_.add_to(std::move(words)));
    }
    const auto master = call.connect();
    WorkerPages workers(*master, name_);
    if (rates_ && !watch_.on()) {
      look(*master, workers);
      pause(std::chrono::seconds(1));
    }
    return watch_.run(call, [&] {
      look(*master, workers);
      if (call.format == Format::table) {
        print_metrics(call.out, *pages_, metrics_);
      } else if (goes_on() && call.format == Format::json) {
        call.out << discovery::to_text(metrics_) << '\n';
      } else {
        print_data(call.out, call.format, metrics_);
      }
      call.out.flush();
      return complain(*pages_, call.err);
    });
  }

 private:
  /// Asks the workers; from the second time on with what was done a second since the last time.
  void look(MasterClient& master, WorkerPages& workers) {
    pages_.emplace(find_topology(name_, master), workers);
    const auto now = std::chrono::steady_clock::now();
    auto metrics = pages_->metrics();
    if (!metrics_.is_null()) add_rates(metrics, metrics_, std::chrono::duration<double>(now - at_).count());
    metrics_ = std::move(metrics);
    at_ = now;
  }

  WatchOption watch_;
  bool rates_ = false;
  std::string window_;
  std::optional<TopologyPages> pages_;
  TopologyPages::Json metrics_;
  std::chrono::steady_clock::time_point at_{};
};

class Errors final : public OfAnyTopology {
 public:
  Errors()
      : OfAnyTopology({"errors", "Show how often each task failed a tuple with an error, and the last one",
                       "iotcloud topology errors echo", Role::viewer}) {}

  int run(Call& call) override {
    if (engine_.storm()) engine_.become(call, {"errors", name_});
    const auto master = call.connect();
    WorkerPages workers(*master, name_);
    const TopologyPages pages(find_topology(name_, *master), workers);
    Rows rows;
    Json json = Json::array();
    const Json metrics = pages.metrics();
    for (const Json& component : metrics.at("components")) {
      for (const Json& task : component.at("tasks")) {
        if (task.at("errors") == 0) continue;
        const Json row{{"component", component.at("component")},
                       {"worker", task.at("worker")},
                       {"task", task.at("task")},
                       {"errors", task.at("errors")},
                       {"error", task.at("last_error")}};
        rows.push_back({printable(row.at("component").get<std::string>()),
                        printable(row.at("worker").get<std::string>()), row.at("task").dump(), row.at("errors").dump(),
                        printable(row.at("error").get<std::string>())});
        json.push_back(row);
      }
    }
    print(call.out, call.format, {"COMPONENT", "WORKER", "TASK", "ERRORS", "LAST ERROR"}, rows, json);
    return complain(pages, call.err);
  }
};

class Tap final : public OfTopology {
 public:
  Tap()
      : OfTopology({"tap", "Show a sample of the tuples that a component emits, or, when it emits none, takes in",
                    "iotcloud topology tap echo data_receive --count 5", Role::viewer}) {}

  void declare(CLI::App& options) override {
    OfTopology::declare(options);
    options.add_option("COMPONENT", request_.component, "the component")->required();
    options.add_option("-n,--count", request_.samples, "end after so many; without it: when interrupted")
        ->check(CLI::Range(std::int64_t{1}, std::int64_t{1'000'000'000}))
        ->type_name("N");
    options.add_option("--rate", request_.rate, "samples a second at most, of each task")
        ->check(CLI::Range(0.01, 1000.0))
        ->type_name("R");
    options.add_option("--stream", request_.stream, "only of this stream")->type_name("STREAM");
  }
  bool goes_on() const override { return true; }
  int run(Call& call) override {
    const auto master = call.connect();
    return tap(call, request_, find_topology(name_, *master), *master);
  }

 private:
  TapRequest request_;
};

/// activate, deactivate, rebalance, kill
class ChangeTopology final : public Verb {
 public:
  ChangeTopology(const Card& of, TopologyChange change) : Verb(of) { request_.change = change; }

  void declare(CLI::App& options) override {
    options.add_option("TOPOLOGY", request_.topology, "the topology")->required();
    add_wait(options, request_.wait, "--timeout", "seconds to wait until all workers have followed");
    engine_.declare(options, "one of workers of ours");
    if (request_.change == TopologyChange::rebalance) {
      options.add_option("COMPONENT=N", parallelism_, "from 1 to the component's number of tasks");
      engine_.for_storm(*options.add_option("--workers", workers_, "with Storm: how many workers it has from now on")
                             ->check(CLI::Range(1, 10'000))
                             ->type_name("N"));
    }
    if (request_.change == TopologyChange::kill)
      add_seconds(options, "--drain", request_.drain, 0.0, 600.0, "seconds that what is under way may take")
          .default_str("10");
  }

  void check() override {
    engine_.check();
    const bool rebalances = request_.change == TopologyChange::rebalance;
    if (rebalances && parallelism_.empty() && !workers_)
      throw CLI::RequiredError(engine_.storm() ? "COMPONENT=N or --workers" : "COMPONENT=N");
    if (engine_.storm() && request_.wait && !rebalances)
      throw CLI::ValidationError("--timeout", "Storm has done this when its Nimbus answers, and kills after --drain");
    for (const auto& [component, count] : pairs(parallelism_, "COMPONENT=N")) {
      auto& number = request_.parallelism[component];
      if (!CLI::detail::lexical_cast(count, number) || number < 1)
        throw CLI::ValidationError("COMPONENT=N", component + "=" + count + ": N is a whole number from 1 on");
    }
  }

  int run(Call& call) override {
    if (engine_.storm()) become_storm(call);
    const auto result = call.connect()->order(request_);
    const int status = result.all_done() ? exit_ok : exit_failed;
    if (call.format != Format::table) {
      print_data(call.out, call.format,
                 {{"ok", result.all_done()},
                  {"text", result.summary()},
                  {"outcomes", discovery::json_of<Json>(result.outcomes)}});
      return status;
    }
    if (result.refusal != OrderRefusal::none) {
      call.err << "iotcloud: " << printable(result.text) << '\n';
      return exit_failed;
    }
    Rows rows;
    for (const auto& outcome : result.outcomes)
      rows.push_back(
          {printable(outcome.worker), printable(outcome.host), to_string(outcome.outcome), printable(outcome.reason)});
    if (!rows.empty()) print_table(call.out, {"WORKER", "HOST", "OUTCOME", "REASON"}, rows);
    if (!result.text.empty()) call.out << printable(result.text) << '\n';
    return status;
  }

 private:
  [[noreturn]] void become_storm(const Call& call) const {
    std::vector<std::string> words{card.name, request_.topology};
    words.insert(words.end(), parallelism_.begin(), parallelism_.end());
    add_word(words, "--workers", workers_);
    add_word(words, "--limit", request_.wait);
    if (request_.change == TopologyChange::kill) add_word(words, "--wait", WaitLimit(request_.drain));
    engine_.become(call, std::move(words));
  }

  TopologyRequest request_;
  std::vector<std::string> parallelism_;
  std::optional<int> workers_;
  EngineChoice engine_;
};

/// Replaces this process by the program `iotcloud-topology`, which knows topologies.
class Check final : public Verb {
 public:
  Check()
      : Verb({"check", "Check a topology's YAML file, and show its graph; asks no master",
              "iotcloud topology check follower.yaml", std::nullopt, false}) {}
  void declare(CLI::App& options) override { options.add_option("FILE", file_, "the file")->required(); }
  int run(Call& call) override {
    std::error_code unknown;
    const auto program = std::filesystem::read_symlink("/proc/self/exe", unknown).parent_path() / "iotcloud-topology";
    const char* words[] = {program.c_str(), "--check", file_.c_str(), nullptr};
    execv(program.c_str(), const_cast<char* const*>(words));
    call.err << fmt::format(
        "iotcloud: {} cannot be run ({}); it checks topologies, and is installed beside this "
        "program\n",
        program.string(), std::strerror(errno));
    return exit_failed;
  }

 private:
  std::string file_;
};

}  // namespace

std::string topology_state(const TopologyStatus& topology) {
  std::set<std::string> states;
  for (const auto& worker : topology.workers) states.insert(worker.state);
  if (states.size() > 1) return "mixed";
  if (!states.empty()) return printable(*states.begin());
  if (topology.order && topology.order->kill) return "killed";
  return topology.order && !topology.order->active ? "inactive" : "no worker";
}

std::int64_t revision_of(const TopologyStatus& topology) {
  return topology.order ? topology.order->revision : 0;
}

void add_topology_verbs(Verbs& verbs) {
  auto& group = verbs.group("topology", "See topologies that run, and change them");
  group.add(list_topologies_verb("list", "List the topologies, and whether they are active",
                                 "iotcloud topology list -o json"));
  group.add<Show>();
  const auto change = [&](TopologyChange kind, const char* name, const char* what, const char* example) {
    group.add<ChangeTopology>(Verb::Card{name, what, example, Role::operating}, kind);
  };
  change(TopologyChange::activate, "activate", "Let the spouts of a topology go on", "iotcloud topology activate echo");
  change(TopologyChange::deactivate, "deactivate",
         "Let the spouts of a topology pause; what is under way goes on. It stays so, for workers that start later too",
         "iotcloud topology deactivate echo");
  change(
      TopologyChange::rebalance, "rebalance",
      "Change how many tasks of a component may run at the same time, in each worker; for later workers too. On Storm "
      "also the number of workers",
      "iotcloud topology rebalance echo echo_send=2");
  change(TopologyChange::kill, "kill",
         "End a topology: its workers take nothing in, finish what is under way, and their processes end",
         "iotcloud topology kill echo --drain 30");
  add_submission_verbs(group);
  group.add<Metrics>();
  group.add<Errors>();
  group.add<Tap>();
  group.add<Check>();
  group.add(pack_topology_verb());
}

}  // namespace iotcloud::master::cli
