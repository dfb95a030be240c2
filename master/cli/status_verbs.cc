// gateways, topologies (also `topology list`), status, health
#include <algorithm>
#include <map>
#include <ostream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/topology/engine_choice.h>
#include <iotcloud/master/cli/topology/topology_verbs.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/cli/watch.h>
#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::master::cli {

using discovery::GatewayStatus;
using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

const char* state_of(const GatewayStatus& gateway) {
  return gateway.alive ? "ready" : "lost";
}

class Gateways final : public WatchedVerb {
 public:
  Gateways()
      : WatchedVerb({"gateways", "List the gateways, and whether they live", "iotcloud gateways", Role::viewer}) {}

  int show(Call& call, MasterClient& master) override {
    const auto gateways = master.gateways();
    Rows rows;
    Json json = Json::array();
    for (const auto& gateway : gateways) {
      const auto& record = gateway.record;
      rows.push_back({printable(record.id),
                      std::string(state_of(gateway)) + (gateway.draining ? ", draining" : "") +
                          (gateway.frozen.empty() ? "" : ", frozen"),
                      fmt::format("{}:{}", record.host, record.port),
                      printable(fmt::format("{}", fmt::join(record.brokers, ","))), age(record.since_ms, now_ms()),
                      printable(record.trouble)});
      json.push_back({{"gateway", record.id},
                      {"state", state_of(gateway)},
                      {"draining", gateway.draining},
                      {"frozen", gateway.frozen},
                      {"host", record.host},
                      {"port", record.port},
                      {"brokers", record.brokers},
                      {"since_ms", record.since_ms},
                      {"trouble", record.trouble}});
    }
    print(call.out, call.format, {"GATEWAY", "STATE", "ADDRESS", "BROKERS", "SINCE", "TROUBLE"}, rows, json);
    return exit_ok;
  }
};

std::vector<std::string> worker_names(const discovery::TopologyStatus& topology) {
  std::vector<std::string> names;
  for (const auto& worker : topology.workers) names.push_back(worker.name);
  return names;
}

class Topologies final : public WatchedVerb {
 public:
  using WatchedVerb::WatchedVerb;

  void declare(CLI::App& options) override {
    WatchedVerb::declare(options);
    engine_.declare(options, "those of workers of ours");
  }
  void check() override { engine_.check(); }
  int run(Call& call) override {
    if (engine_.storm()) engine_.become(call, watched().add_to({"list"}));
    return WatchedVerb::run(call);
  }
  int show(Call& call, MasterClient& master) override {
    Rows rows;
    Json json = Json::array();
    for (const auto& topology : master.topologies()) {
      const auto& record = topology.record;
      rows.push_back({printable(record.name), topology_state(topology), std::to_string(topology.workers.size()),
                      age(record.since_ms, now_ms()), printable(fmt::format("{}", fmt::join(record.spouts, ","))),
                      printable(fmt::format("{}", fmt::join(record.bolts, ",")))});
      json.push_back({{"topology", record.name},
                      {"state", topology_state(topology)},
                      {"revision", revision_of(topology)},
                      {"workers", worker_names(topology)},
                      {"spouts", record.spouts},
                      {"bolts", record.bolts},
                      {"since_ms", record.since_ms}});
    }
    print(call.out, call.format, {"TOPOLOGY", "STATE", "WORKERS", "SINCE", "SPOUTS", "BOLTS"}, rows, json);
    return exit_ok;
  }

 private:
  EngineChoice engine_;
};

/// The master's role for people.
std::string role(const MasterStatus& status) {
  if (status.leading) return fmt::format("leads, epoch {}", status.epoch);
  return status.leader.empty() ? "standby; no master leads" : fmt::format("standby; {} leads", status.leader);
}

class Status final : public WatchedVerb {
 public:
  Status()
      : WatchedVerb({"status", "Show who leads, gateways, drivers by state, and topologies",
                     "iotcloud --master lab1:12904,lab2:12904 status", Role::viewer}) {}

  int show(Call& call, MasterClient& master) override {
    const auto status = master.status();
    const std::vector<std::string> head{
        "master", fmt::format("{} at {} ({})", printable(status.id), master.address(), role(status))};
    Json json{{"master",
               {{"id", status.id},
                {"address", master.address()},
                {"leading", status.leading},
                {"leader", status.leader},
                {"epoch", status.epoch},
                {"registry", status.registry_away ? "away" : "connected"}}}};
    if (status.registry_away) {  // nothing else is known
      print(call.out, call.format, head, {{"registry", "away; the master keeps trying to reach it"}}, json);
      return exit_failed;
    }
    const auto gateways = master.gateways();
    const auto topologies = master.topologies();
    std::map<std::string, int> drivers;
    for (const auto& driver : master.drivers()) ++drivers[to_string(driver.state)];
    const auto ready = std::count_if(gateways.begin(), gateways.end(), [](const auto& g) { return g.alive; });
    const auto lost = static_cast<std::ptrdiff_t>(gateways.size()) - ready;
    const auto frozen =
        std::count_if(gateways.begin(), gateways.end(), [](const auto& g) { return !g.frozen.empty(); });

    std::vector<std::string> states, names, troubles;
    Json list = Json::array();
    for (const auto& gateway : gateways) {
      if (gateway.alive && !gateway.record.trouble.empty())
        troubles.push_back(fmt::format("gateway {}: {}", gateway.record.id, gateway.record.trouble));
    }
    for (const auto& [state, count] : drivers) states.push_back(fmt::format("{} {}", count, state));
    for (const auto& topology : topologies) {
      const auto workers = topology.workers.size();
      names.push_back(fmt::format("{} ({} worker{})", topology.record.name, workers, workers == 1 ? "" : "s"));
      Json trouble = Json::array();
      if (workers == 0) {
        trouble.push_back("no worker runs");
        troubles.push_back(fmt::format("{}: no worker runs", topology.record.name));
      }
      for (const auto& worker : topology.workers) {
        if (worker.trouble.empty()) continue;
        trouble.push_back(worker.trouble);
        troubles.push_back(fmt::format("{}: {}", topology.record.name, worker.trouble));
      }
      list.push_back({{"topology", topology.record.name}, {"workers", workers}, {"trouble", trouble}});
    }
    const auto or_none = [](const std::vector<std::string>& items) {
      return items.empty() ? "none" : fmt::format("{}", fmt::join(items, ", "));
    };
    json.update({{"gateways", {{"ready", ready}, {"lost", lost}, {"frozen", frozen}}},
                 {"drivers", drivers},
                 {"topologies", list},
                 {"trouble", troubles}});
    print(call.out, call.format, head,
          {{"registry", "connected"},
           {"gateways",
            fmt::format(
                "{} ready{}{}", ready, lost > 0 ? fmt::format(", {} lost", lost) : "",
                frozen > 0 ? fmt::format(", {} frozen: `iotcloud registry adopt` lets them follow orders again", frozen)
                           : "")},
           {"drivers", or_none(states)},
           {"topologies", printable(or_none(names))},
           {"trouble", printable(or_none(troubles))}},
          json);
    return exit_ok;
  }
};

/// Asks one daemon, no master: for health checks of containers.
class Health final : public Verb {
 public:
  Health()
      : Verb({"health", "Ask a daemon's pages whether it is well; exit status 0: it is", "iotcloud health lab3:9406",
              std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("ADDRESS", address_, "host:port of its pages (its key metrics.address)")->required();
  }
  int run(Call& call) override {
    try {
      call.out << rpc::http_get(address_, "/healthz", {call.access.tls, call.access.token});
      return exit_ok;
    } catch (const rpc::HttpError& error) {
      call.err << "iotcloud: " << printable(error.what()) << '\n';
      return exit_failed;
    }
  }

 private:
  std::string address_;
};

}  // namespace

std::unique_ptr<Verb> list_topologies_verb(const char* name, const char* what, const char* example) {
  return std::make_unique<Topologies>(Verb::Card{name, what, example, Role::viewer});
}

void add_gateway_verbs(Verbs& verbs) {
  verbs.add<Gateways>();
}

void add_status_verbs(Verbs& verbs) {
  verbs.add(list_topologies_verb("topologies", "List the topologies that run, and their workers",
                                 "iotcloud topologies -o json"));
  verbs.add<Status>();
  verbs.add<Health>();
}

}  // namespace iotcloud::master::cli
