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
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/plugins/signing_command.h>
#include <iotcloud/master/cli/security/security_command.h>
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

/// Gateways that did not take the plugin are outcomes of their own.
void add_failures(wire::TOrderResponse& answer, const SentPlugin& sent) {
  if (sent.failures.empty()) return;
  answer.outcomes.insert(answer.outcomes.end(), sent.failures.begin(), sent.failures.end());
  answer.response.state = discovery::wire::TResponseState::FAILURE;
  answer.response.statusMessage +=
      fmt::format("{}{} gateway{} did not take the plugin", answer.response.statusMessage.empty() ? "" : "; ",
                  sent.failures.size(), sent.failures.size() == 1 ? "" : "s");
}

wire::TOrderResponse failed_to_send(const SentPlugin& sent) {
  wire::TOrderResponse answer;
  answer.__set_refusal(wire::TRefusal::NONE);
  add_failures(answer, sent);
  return answer;
}

/// Nothing is changed unless all gateways of the instances have the plugin.
int update(const Command& command, const wire::TInstanceSelection& selection, MasterClient& master, std::ostream& out,
           std::ostream& err) {
  const std::set<std::string> chosen(selection.instances.begin(), selection.instances.end());
  std::set<std::string> gateways;
  for (const auto& driver : master.drivers()) {
    if (chosen.contains(driver.sensorId)) gateways.insert(driver.siteId);
  }
  wire::TUpdateRequest request;
  request.__set_selection(selection);
  request.__set_atOnce(command.at_once);
  request.__set_settleMs(command.settle_ms);
  SentPlugin sent;
  sent.plugin = command.plugin;
  if (!gateways.empty())
    sent = send_plugin(command.plugin, {gateways.begin(), gateways.end()}, master, command.progress ? &err : nullptr);
  if (!sent.failures.empty()) {
    err << "iotcloud: not all gateways took the plugin, so no instance was updated\n";
    return show_order(command, failed_to_send(sent), out, err);
  }
  request.__set_plugin(sent.plugin);
  request.__set_sha256(sent.sha256);
  const auto per_step = static_cast<std::size_t>(command.at_once);
  const std::size_t steps = per_step == 0 ? gateways.size() : (chosen.size() + per_step - 1) / per_step;
  return show_order(command, master.update(request, steps), out, err);
}

/// A plugin that is sent to all gateways passes those by that drain, as the order does.
std::vector<std::string> gateways_to_send_to(const Command& command, MasterClient& master) {
  if (!command.gateways.empty()) return command.gateways;
  std::vector<std::string> ids;
  bool draining = false;
  for (const auto& gateway : master.gateways()) {
    draining = draining || gateway.draining;
    if (!gateway.draining) ids.push_back(gateway.siteId);
  }
  if (ids.empty() && draining) throw Failed("all gateways are draining; `iotcloud undrain GATEWAY` ends that");
  return ids;
}

int deploy(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  SentPlugin sent;
  sent.plugin = command.plugin;
  if (is_local_plugin(command.plugin))
    sent = send_plugin(command.plugin, gateways_to_send_to(command, master), master, command.progress ? &err : nullptr);
  if (!sent.sha256.empty() && sent.gateways.empty()) return show_order(command, failed_to_send(sent), out, err);
  wire::TDeployRequest request;
  request.__set_gateways(sent.sha256.empty() ? command.gateways : sent.gateways);
  request.__set_plugin(sent.plugin);
  request.__set_sha256(sent.sha256);
  request.__set_driver(command.driver);
  request.__set_properties(command.properties);
  request.__set_metadata(command.metadata);
  request.__set_count(command.count);
  request.__set_waitMs(command.wait_ms);
  request.__set_name(command.name);
  auto answer = master.deploy(request);
  add_failures(answer, sent);
  return show_order(command, answer, out, err);
}

int order(const Command& command, const discovery::Selection& where, MasterClient& master, std::ostream& out,
          std::ostream& err) {
  if (command.verb == Verb::deploy) return deploy(command, master, out, err);
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
  if (command.verb == Verb::update) return update(command, selection, master, out, err);
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
    if (command.verb == Verb::keys_new) return make_keys(command, out);
    if (command.verb == Verb::sign) return sign_plugin(command, out);
    if (is_security(command.verb)) return run_security(command, out);
    const auto where = where_of(command);  // before a master is asked
    const auto connect = [&] {
      return std::make_unique<MasterClient>(command.masters, MasterAccess{command.tls, command.token},
                                            command.election_patience);
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
      case Verb::update:
        return order(command, where, master, out, err);
      case Verb::topology_show:
      case Verb::topology_activate:
      case Verb::topology_deactivate:
      case Verb::topology_rebalance:
      case Verb::topology_kill:
      case Verb::topology_metrics:
      case Verb::topology_tap:
      case Verb::topology_check:
      case Verb::keys_new:
      case Verb::sign:
        return run_topology(command, master, out, err);
      case Verb::diff:
      case Verb::apply:
        return run_fleet(command, connect, out, err);
      case Verb::certs_init:
      case Verb::certs_add:
      case Verb::token_add:
      case Verb::token_remove:
      case Verb::token_list:
        return run_security(command, out);
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
  } catch (const config::Error& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_failed;
  } catch (const Failed& e) {
    err << "iotcloud: " << e.what() << '\n';
    return exit_failed;
  }
  return exit_usage;
}

}  // namespace iotcloud::master::cli
