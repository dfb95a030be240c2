// topology submit, update, rollback, history, logs, pools: topologies that pools of workers run
#include <ostream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/log_lines.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/topology/engine_choice.h>
#include <iotcloud/master/cli/topology/submission.h>
#include <iotcloud/master/cli/topology/topology_verbs.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

/// Prints what became of a topology's worker places. \return the exit status
int print_places(const OrderResult& result, Call& call) {
  const int status = result.all_done() ? exit_ok : exit_failed;
  if (call.format != Format::table) {
    auto outcomes = Json::array();
    for (const auto& outcome : result.outcomes) {
      outcomes.push_back({{"place", outcome.instance},
                          {"pool", outcome.gateway},
                          {"outcome", to_string(outcome.outcome)},
                          {"reason", outcome.reason}});
    }
    print_data(call.out, call.format,
               {{"ok", result.all_done()}, {"text", result.summary()}, {"outcomes", std::move(outcomes)}});
    return status;
  }
  if (result.refusal != OrderRefusal::none) {
    call.err << "iotcloud: " << printable(result.text) << '\n';
    return exit_failed;
  }
  Rows rows;
  for (const auto& outcome : result.outcomes) {
    rows.push_back({printable(outcome.instance), outcome.gateway.empty() ? "-" : printable(outcome.gateway),
                    to_string(outcome.outcome), printable(outcome.reason)});
  }
  print_table(call.out, {"PLACE", "POOL", "OUTCOME", "REASON"}, rows);
  return status;
}

/// submit, update
class Submit final : public Verb {
 public:
  Submit(const Card& of, bool update) : Verb(of), update_(update) {}

  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the topology's YAML file; its component libraries are sent, too")
        ->required()
        ->type_name("FILE");
    options
        .add_option("--workers", request_.workers,
                    update_ ? "how many workers it has from now on; without it as many as it has"
                            : "how many workers it has, over all pools")
        ->check(CLI::Range(1, discovery::Submission::most_workers))
        ->type_name("N");
    add_wait(options, request_.wait, "--wait",
             update_ ? "seconds that each worker may take, and as long again to go back"
                     : "seconds to wait until all workers run; the master decides when it is not given");
    if (update_) {
      add_settle(options, request_.settle);
    } else {
      engine_.declare(options, "as the file says (its key engine.storm), else pool");
    }
  }

  void check() override {
    if (!engine_.given().empty()) engine_.check();  // else the file decides
  }

  int run(Call& call) override {
    if (!update_) engine_.take(engine_for(file_, engine_.given()));
    if (engine_.storm()) become_storm(call);
    const auto master = call.connect();
    std::vector<InstanceOutcome> failures;
    prepare(request_, file_, *master, call.progress ? &call.err : nullptr, failures);
    for (const auto& failure : failures) {
      call.err << fmt::format("iotcloud: pool {} did not take a library, and gets no worker of it: {}\n",
                              printable(failure.gateway), printable(failure.reason));
    }
    return print_places(give(request_, update_, *master), call);
  }

 private:
  [[noreturn]] void become_storm(const Call& call) const {
    std::vector<std::string> words{"submit", file_};
    if (request_.workers > 0) words.insert(words.end(), {"--workers", std::to_string(request_.workers)});
    add_word(words, "--limit", request_.wait);
    engine_.become(call, std::move(words));
  }

  const bool update_;
  std::string file_;
  EngineChoice engine_;
  SubmitRequest request_;
};

/// A verb about one topology.
class OfSubmitted : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override { options.add_option("TOPOLOGY", name_, "the topology")->required(); }

 protected:
  discovery::TopologyName name_;
};

class Rollback final : public OfSubmitted {
 public:
  Rollback()
      : OfSubmitted({"rollback", "Give a submitted topology the version before its last update, worker by worker",
                     "iotcloud topology rollback echo", Role::admin}) {}
  void declare(CLI::App& options) override {
    OfSubmitted::declare(options);
    add_wait(options, request_.wait, "--wait", "seconds that each worker may take, and as long again to go back");
    add_settle(options, request_.settle);
  }
  int run(Call& call) override {
    request_.topology = name_;
    const auto master = call.connect();
    const auto steps = steps_of(name_, *master);
    return print_places(
        master->give("rollbackTopology", discovery::to_text(discovery::to_json<Json>(request_)), request_.wait, steps),
        call);
  }

 private:
  RollbackRequest request_;
};

class TopologyHistoryVerb final : public OfSubmitted {
 public:
  TopologyHistoryVerb()
      : OfSubmitted(
            {"history",
             "List what was ordered for a submitted topology, and what became of it; also of one that was killed",
             "iotcloud topology history echo", Role::viewer}) {}
  int run(Call& call) override {
    const auto events = call.connect()->topology_history(name_);
    if (events.empty()) throw RequestFailed(fmt::format("no topology \"{}\" was submitted to the pools", name_));
    Rows rows;
    for (const auto& event : events) {
      rows.push_back({moment(event.time_ms), printable(event.order), std::to_string(event.version),
                      printable(security::short_sha256(event.digest)), std::to_string(event.workers),
                      printable(event.outcome)});
    }
    print(call.out, call.format, {"TIME", "ORDER", "VERSION", "CONTENT", "WORKERS", "OUTCOME"}, rows,
          discovery::json_of<Json>(events));
    return exit_ok;
  }
};

class WorkerLogs final : public OfSubmitted {
 public:
  WorkerLogs()
      : OfSubmitted({"logs", "Show what the workers at a place of a submitted topology log",
                     "iotcloud topology logs echo --place 1 --follow", Role::viewer}) {}
  void declare(CLI::App& options) override {
    OfSubmitted::declare(options);
    options.add_option("--place", place_, "the place's number: `iotcloud topology show` lists them")
        ->check(CLI::Range(0, discovery::Submission::most_workers))
        ->capture_default_str()
        ->type_name("N");
    options.add_flag("-f,--follow", choice_.follow, "go on until interrupted");
    options.add_option("-n,--lines", choice_.lines, "of what there is already, at most")
        ->check(CLI::Range(0, 10'000))
        ->default_str("100")
        ->type_name("N");
  }
  bool goes_on() const override { return choice_.follow; }
  int run(Call& call) override {
    const auto master = call.connect();
    return show_log(call, choice_, [&](const std::string& position) {
      return master->read_worker_log({name_, place_}, position, most_log_bytes);
    });
  }

 private:
  int place_ = 0;
  LogChoice choice_;
};

class Pools final : public Verb {
 public:
  Pools() : Verb({"pools", "List the pools of workers, and what they run", "iotcloud topology pools", Role::viewer}) {}
  void declare(CLI::App&) override {}
  int run(Call& call) override {
    const auto pools = call.connect()->pools();
    Rows rows;
    for (const auto& pool : pools) {
      std::vector<std::string> places;
      for (const auto& place : pool.places) {
        places.push_back(fmt::format("{}/{}{}", place.topology, place.place,
                                     place.state == "running" ? "" : " (" + place.state + ")"));
      }
      rows.push_back({printable(pool.id), printable(fmt::format("{}:{}", pool.host, pool.port)),
                      fmt::format("{}{}", pool.places.size(),
                                  pool.most_workers > 0 ? fmt::format(" of {}", pool.most_workers) : ""),
                      age(pool.since_ms, now_ms()), printable(fmt::format("{}", fmt::join(places, ", "))),
                      printable(pool.trouble)});
    }
    print(call.out, call.format, {"POOL", "ADDRESS", "WORKERS", "SINCE", "PLACES", "TROUBLE"}, rows,
          discovery::json_of<Json>(pools));
    return exit_ok;
  }
};

}  // namespace

void add_submission_verbs(Verbs& group) {
  group.add<Submit>(
      Verb::Card{
          "submit",
          "Have a topology run by pools of workers, or by Apache Storm: its file and its component libraries are "
          "checked and sent. Answers when all workers run, or why not",
          "iotcloud topology submit follower.yaml --workers 2", Role::admin},
      false);
  group.add<Submit>(
      Verb::Card{
          "update",
          "Give a submitted topology another file, or other libraries, worker by worker. When one does not run, all "
          "go back",
          "iotcloud topology update follower.yaml", Role::admin},
      true);
  group.add<Rollback>();
  group.add<TopologyHistoryVerb>();
  group.add<WorkerLogs>();
  group.add<Pools>();
}

}  // namespace iotcloud::master::cli
