#include <algorithm>
#include <chrono>
#include <functional>
#include <ostream>
#include <set>
#include <stdexcept>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/command.h>
#include <iotcloud/master/cli/drivers_command.h>
#include <iotcloud/master/cli/fleet/fleet_command.h>
#include <iotcloud/master/cli/history_command.h>
#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/topology/topology_command.h>

namespace iotcloud::master::cli {

using discovery::wire::TDirection;
using discovery::wire::TSensor;
using discovery::wire::TSite;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

std::int64_t now_ms() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(system_clock::now().time_since_epoch()).count();
}

const char* state_of(const TSite& gateway) {
  return gateway.alive ? "ready" : "lost";
}

std::string state_and_draining(const TSite& gateway) {
  return std::string(state_of(gateway)) + (gateway.draining ? ", draining" : "");
}

std::vector<std::string> broker_names(const TSite& gateway) {
  std::vector<std::string> names;
  for (const auto& broker : gateway.brokers) names.push_back(broker.name);
  return names;
}

int show_gateways(const Command& command, MasterClient& master, std::ostream& out) {
  const auto gateways = master.gateways();
  if (command.format == Format::table) {
    Rows rows;
    for (const auto& gateway : gateways)
      rows.push_back(
          {printable(gateway.siteId), state_and_draining(gateway), fmt::format("{}:{}", gateway.host, gateway.port),
           printable(fmt::format("{}", fmt::join(broker_names(gateway), ","))), age(gateway.sinceMs, now_ms())});
    print_table(out, {"GATEWAY", "STATE", "ADDRESS", "BROKERS", "SINCE"}, rows);
    return exit_ok;
  }
  Json json = Json::array();
  for (const auto& gateway : gateways)
    json.push_back({{"gateway", gateway.siteId},
                    {"state", state_of(gateway)},
                    {"draining", gateway.draining},
                    {"host", gateway.host},
                    {"port", gateway.port},
                    {"brokers", broker_names(gateway)},
                    {"since_ms", gateway.sinceMs}});
  print_data(out, command.format, json);
  return exit_ok;
}

int show_topologies(const Command& command, MasterClient& master, std::ostream& out) {
  const auto topologies = master.topologies();
  if (command.format == Format::table) {
    Rows rows;
    for (const auto& topology : topologies)
      rows.push_back({printable(topology.name), topology_state(topology), std::to_string(topology.workers.size()),
                      age(topology.sinceMs, now_ms()), printable(fmt::format("{}", fmt::join(topology.spouts, ","))),
                      printable(fmt::format("{}", fmt::join(topology.bolts, ",")))});
    print_table(out, {"TOPOLOGY", "STATE", "WORKERS", "SINCE", "SPOUTS", "BOLTS"}, rows);
    return exit_ok;
  }
  Json json = Json::array();
  for (const auto& topology : topologies)
    json.push_back({{"topology", topology.name},
                    {"state", topology_state(topology)},
                    {"revision", topology.revision},
                    {"workers", topology.workers},
                    {"spouts", topology.spouts},
                    {"bolts", topology.bolts},
                    {"since_ms", topology.sinceMs}});
  print_data(out, command.format, json);
  return exit_ok;
}

/// What a master says of itself.
std::string role(const wire::TMasterStatus& status) {
  if (status.leading) return fmt::format("leads, epoch {}", status.epoch);
  return status.leader.empty() ? "standby; no master leads" : fmt::format("standby; {} leads", status.leader);
}

Json to_json(const wire::TMasterStatus& status, const std::string& address) {
  return {{"id", status.id},         {"address", address},    {"leading", status.leading},
          {"leader", status.leader}, {"epoch", status.epoch}, {"registry", status.registryAway ? "away" : "connected"}};
}

/// All that can be said while the master has no connection to the registry.
int show_status_without_registry(const Command& command, MasterClient& master, const wire::TMasterStatus& status,
                                 std::ostream& out) {
  if (command.format == Format::table) {
    print_table(out, {"master", fmt::format("{} at {} ({})", printable(status.id), master.address(), role(status))},
                {{"registry", "away; the master keeps trying to reach it"}});
  } else {
    print_data(out, command.format, {{"master", to_json(status, master.address())}});
  }
  return exit_failed;
}

int show_status(const Command& command, MasterClient& master, std::ostream& out) {
  const auto status = master.status();
  if (status.registryAway) return show_status_without_registry(command, master, status, out);
  const auto gateways = master.gateways();
  const auto topologies = master.topologies();
  std::map<std::string, int> drivers;
  for (const auto& driver : master.drivers()) ++drivers[driver.exactState];
  const auto ready = std::count_if(gateways.begin(), gateways.end(), [](const auto& g) { return g.alive; });
  const auto lost = static_cast<std::ptrdiff_t>(gateways.size()) - ready;

  if (command.format == Format::table) {
    std::vector<std::string> states;
    for (const auto& [state, count] : drivers) states.push_back(fmt::format("{} {}", count, state));
    std::vector<std::string> names;
    for (const auto& topology : topologies)
      names.push_back(fmt::format("{} ({} worker{})", topology.name, topology.workers.size(),
                                  topology.workers.size() == 1 ? "" : "s"));
    const auto or_none = [](const std::vector<std::string>& items) {
      return items.empty() ? "none" : fmt::format("{}", fmt::join(items, ", "));
    };
    print_table(out, {"master", fmt::format("{} at {} ({})", printable(status.id), master.address(), role(status))},
                {{"registry", "connected"},
                 {"gateways", fmt::format("{} ready{}", ready, lost > 0 ? fmt::format(", {} lost", lost) : "")},
                 {"drivers", or_none(states)},
                 {"topologies", printable(or_none(names))}});
    return exit_ok;
  }
  Json names = Json::array();
  for (const auto& topology : topologies)
    names.push_back({{"topology", topology.name}, {"workers", topology.workers.size()}});
  print_data(out, command.format,
             {{"master", to_json(status, master.address())},
              {"gateways", {{"ready", ready}, {"lost", lost}}},
              {"drivers", drivers},
              {"topologies", names}});
  return exit_ok;
}

int show_order(const Command& command, const wire::TOrderResponse& answer, std::ostream& out, std::ostream& err) {
  const bool ok = answer.response.state == discovery::wire::TResponseState::SUCCESS;
  if (command.format == Format::table) {
    if (answer.refusal != wire::TRefusal::NONE) {
      err << "iotcloud: " << printable(answer.response.statusMessage) << '\n';
      return exit_failed;
    }
    Rows rows;
    for (const auto& outcome : answer.outcomes)
      rows.push_back({outcome.instance, printable(outcome.gateway), word(outcome.outcome), printable(outcome.reason)});
    if (rows.empty()) {
      out << "done; no instance had to change\n";
    } else {
      print_table(out, {"INSTANCE", "GATEWAY", "OUTCOME", "REASON"}, rows);
    }
    return ok ? exit_ok : exit_failed;
  }
  Json outcomes = Json::array();
  for (const auto& outcome : answer.outcomes)
    outcomes.push_back({{"instance", outcome.instance},
                        {"gateway", outcome.gateway},
                        {"outcome", word(outcome.outcome)},
                        {"reason", outcome.reason}});
  print_data(out, command.format, {{"ok", ok}, {"text", answer.response.statusMessage}, {"outcomes", outcomes}});
  return ok ? exit_ok : exit_failed;
}

int order(const Command& command, const discovery::Selection& where, MasterClient& master, std::ostream& out,
          std::ostream& err) {
  if (command.verb == Verb::deploy) {
    wire::TDeployRequest request;
    request.__set_gateways(command.gateways);
    request.__set_plugin(command.plugin);
    request.__set_driver(command.driver);
    request.__set_properties(command.properties);
    request.__set_metadata(command.metadata);
    request.__set_count(command.count);
    request.__set_waitMs(command.wait_ms);
    request.__set_name(command.name);
    return show_order(command, master.deploy(request), out, err);
  }
  if (command.verb == Verb::drain || command.verb == Verb::undrain) {
    wire::TGatewaySelection selection;
    selection.__set_gateways(command.gateways);
    selection.__set_waitMs(command.wait_ms);
    return show_order(command, command.verb == Verb::drain ? master.drain(selection) : master.undrain(selection), out,
                      err);
  }
  wire::TInstanceSelection selection;
  selection.__set_instances(command.instances.empty() ? fitting_ids(command, where, master)
                                                      : full_ids(command.instances, master));
  selection.__set_gateways(command.gateways);
  selection.__set_waitMs(command.wait_ms);
  const auto answer = command.verb == Verb::metadata   ? master.update_metadata(selection, command.metadata)
                      : command.verb == Verb::undeploy ? master.undeploy(selection)
                      : command.verb == Verb::start    ? master.start(selection)
                                                       : master.stop(selection);
  return show_order(command, answer, out, err);
}

}  // namespace

int run(const Command& command, std::ostream& out, std::ostream& err) {
  try {
    if (command.verb == Verb::topology_check) return check_topology(command, err);
    const auto where = where_of(command);  // before a master is asked
    const auto connect = [&] {
      return std::make_unique<MasterClient>(command.masters, command.token, command.election_patience);
    };
    const auto connection = connect();
    auto& master = *connection;
    switch (command.verb) {
      case Verb::gateways:
        return show_gateways(command, master, out);
      case Verb::drivers:
        return show_drivers(command, where, master, out);
      case Verb::describe:
        return describe(command, master, out, err);
      case Verb::history:
        return show_history(command, master, out, err);
      case Verb::logs:
        return show_logs(command, master, out);
      case Verb::topologies:
        return show_topologies(command, master, out);
      case Verb::status:
        return show_status(command, master, out);
      case Verb::deploy:
      case Verb::undeploy:
      case Verb::start:
      case Verb::stop:
      case Verb::metadata:
      case Verb::drain:
      case Verb::undrain:
        return order(command, where, master, out, err);
      case Verb::topology_show:
      case Verb::topology_activate:
      case Verb::topology_deactivate:
      case Verb::topology_rebalance:
      case Verb::topology_kill:
      case Verb::topology_metrics:
      case Verb::topology_tap:
      case Verb::topology_check:
        return run_topology(command, master, out, err);
      case Verb::diff:
      case Verb::apply:
        return run_fleet(command, connect, out, err);
    }
  } catch (const Ambiguous& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_usage;
  } catch (const config::ConfigError& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_usage;
  } catch (const std::invalid_argument& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_usage;
  } catch (const Unreachable& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_unreachable;
  } catch (const Failed& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_failed;
  }
  return exit_usage;
}

}  // namespace iotcloud::master::cli
