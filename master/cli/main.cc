#include <csignal>
#include <cstdlib>
#include <iostream>
#include <map>
#include <string>

#include <CLI/CLI.hpp>
#include <unistd.h>

#include <iotcloud/config/version.h>
#include <iotcloud/master/cli/arguments.h>
#include <iotcloud/master/cli/command.h>
#include <iotcloud/master/cli/completion.h>
#include <iotcloud/master/cli/fleet/channel_options.h>
#include <iotcloud/master/cli/fleet/fleet_arguments.h>
#include <iotcloud/master/cli/security/security_options.h>

using namespace iotcloud::master::cli;

namespace {

constexpr const char* footer =
    "Exit status: 0 done; 1 failed, for all or for some, or the outcome is not known; 2 wrong usage, or a manifest "
    "that\n"
    "cannot be used; 3 no master answers; 4 diff and apply --dry-run: the fleet is not as the manifest says.\n"
    "Environment: IOTCLOUD_MASTER as --master; IOTCLOUD_CA, IOTCLOUD_CERTIFICATE and IOTCLOUD_KEY as --ca, "
    "--certificate and --key; IOTCLOUD_TOKEN_FILE as --token-file, or the token itself in IOTCLOUD_TOKEN.";

void add_reads(CLI::App& app, Command& command) {
  add(app, command, Verb::gateways, "gateways", "List the gateways, and whether they live", "iotcloud gateways");
  auto& drivers =
      add(app, command, Verb::drivers, "drivers", "List driver instances with their state, and why they are in it",
          "iotcloud drivers --where 'site == \"lab\" and battery > 20'");
  drivers.add_option("ID", command.instances, "ids, or how they begin");
  add_gateways(drivers, command, "only on these gateways");
  add_choice(drivers, command);
  const auto of_one = [&](Verb verb, const char* name, const char* what, const char* example) -> CLI::App& {
    auto& sub = add(app, command, verb, name, what, example);
    sub.add_option("ID", command.instances, "the id of an instance, or how it begins")->required()->expected(1);
    return sub;
  };
  const auto add_lines = [&](CLI::App& sub, int least, const char* what) {
    sub.add_option("-n,--lines", command.lines, what)
        ->check(CLI::Range(least, 10'000))
        ->default_str("100")
        ->type_name("N");
  };
  of_one(Verb::describe, "describe", "Show all that is known of a driver instance: its record, channels and history",
         "iotcloud describe 3f2a9c");
  auto& history = add(app, command, Verb::history, "history",
                      "List the latest changes of state, of instances that are gone too, with time and reason",
                      "iotcloud history --gateway lab1");
  history.add_option("ID", command.instances, "only of these: ids, or how they begin");
  add_gateways(history, command, "only on these gateways");
  add_lines(history, 1, "the latest so many");
  auto& logs = of_one(Verb::logs, "logs", "Show what a driver instance logs", "iotcloud logs 3f2a9c --follow");
  logs.add_flag("-f,--follow", command.follow, "go on until interrupted");
  logs.add_flag("--whole-host", command.whole_host, "every line of its driver host, not only those that name it");
  add_lines(logs, 0, "of what there is already, at most, looked for in the last 128 KiB of its host's log");
  add(app, command, Verb::topologies, "topologies", "List the topologies that run, and their workers",
      "iotcloud topologies -o json");
  add(app, command, Verb::status, "status", "Show who leads, gateways, drivers by state, and topologies",
      "iotcloud --master lab1:12904,lab2:12904 status");
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

CLI::App& add_plugin(CLI::App& sub, Command& command) {
  sub.add_option(
         "--plugin", command.plugin,
         "a name (turtle.so): a file in the gateways' plugin folder; a path, with a slash (./turtle.so): a file of "
         "this machine, which is sent with its signature (./turtle.so.sig)")
      ->type_name("FILE");
  return sub;
}

void add_deploy(CLI::App& app, Command& command, Words& words) {
  auto& deploy = add(app, command, Verb::deploy, "deploy", "Deploy a driver; answers when the outcome is known",
                     "iotcloud deploy turtle.so --gateway lab1 --name robot --property source=simulation\n"
                     "  iotcloud deploy --plugin ./turtle.so --all");
  add_plugin(deploy, command).add_option("PLUGIN", command.plugin, "as --plugin")->excludes("--plugin");
  add_gateways(deploy, command, "on these gateways");
  deploy.add_flag("--all", words.all, "on all gateways")->excludes("--gateway");
  deploy
      .add_option(
          "--name", command.name,
          "what these instances are called: NAME/1, NAME/2, ... on each gateway; one that is there already is not "
          "deployed again")
      ->type_name("NAME");
  deploy.add_option("--driver", command.driver, "the driver's name; the plugin's own when it is not given")
      ->type_name("DRIVER");
  deploy.add_option("-p,--property", words.properties, "a property of the driver; may be repeated")
      ->allow_extra_args(false)
      ->type_name("NAME=VALUE");
  deploy
      .add_option("-c,--channel", words.channels,
                  "what a channel's messages are worth, such as data.deadline_ms=100; may be repeated. Options: " +
                      joined(channel_options()))
      ->allow_extra_args(false)
      ->type_name("CHANNEL.OPTION=VALUE");
  deploy.add_option("-m,--metadata", words.metadata, "what others see in the driver's record; may be repeated")
      ->allow_extra_args(false)
      ->type_name("NAME=VALUE");
  deploy.add_option("-n,--count", command.count, "instances on each gateway")
      ->check(CLI::Range(1, 10'000))
      ->type_name("N");
  add_wait(deploy, words);
}

void add_topology(CLI::App& app, Command& command, Words& words) {
  auto& topology = *app.add_subcommand("topology", "See topologies that run, and change them");
  topology.require_subcommand(1);
  add(topology, command, Verb::topologies, "list", "List the topologies, and whether they are active",
      "iotcloud topology list -o json");
  const auto one = [&](Verb verb, const char* name, const char* what, const char* example) -> CLI::App& {
    auto& sub = add(topology, command, verb, name, what, example);
    sub.add_option("TOPOLOGY", command.topology, "the topology")->required();
    return sub;
  };
  const auto change = [&](Verb verb, const char* name, const char* what, const char* example) -> CLI::App& {
    auto& sub = one(verb, name, what, example);
    sub.add_option("--timeout", words.wait_s, "seconds to wait until all workers have followed")
        ->check(CLI::Range(0.001, 600.0))
        ->type_name("SECONDS");
    return sub;
  };
  one(Verb::topology_show, "show", "Show one topology: its graph, workers, totals and errors",
      "iotcloud topology show echo");
  change(Verb::topology_activate, "activate", "Let the spouts of a topology go on", "iotcloud topology activate echo");
  change(Verb::topology_deactivate, "deactivate",
         "Let the spouts of a topology pause; what is under way goes on. It stays so, for workers that start later too",
         "iotcloud topology deactivate echo");
  change(Verb::topology_rebalance, "rebalance",
         "Change how many tasks of a component may run at the same time, in each worker; for later workers too",
         "iotcloud topology rebalance echo echo_send=2")
      .add_option("COMPONENT=N", words.parallelism, "from 1 to the component's number of tasks")
      ->required();
  change(Verb::topology_kill, "kill",
         "End a topology: its workers take nothing in, finish what is under way, and their processes end",
         "iotcloud topology kill echo --drain 30")
      .add_option("--drain", words.drain_s, "seconds that what is under way may take")
      ->check(CLI::Range(0.0, 600.0))
      ->default_str("10")
      ->type_name("SECONDS");
  one(Verb::topology_metrics, "metrics",
      "Show what every component and task did. Of several tasks: sums; p50 of the one with the most samples, p99 and "
      "max "
      "of the worst",
      "iotcloud topology metrics echo --watch")
      .add_option("--watch", command.watch_s, "again every so many seconds until interrupted; 1 when none are given")
      ->expected(0, 1)
      ->default_str("1")
      ->check(CLI::Range(0.1, 3600.0))
      ->type_name("SECONDS");
  auto& tap = one(Verb::topology_tap, "tap",
                  "Show a sample of the tuples that a component emits, or, when it emits none, takes in",
                  "iotcloud topology tap echo data_receive --count 5");
  tap.add_option("COMPONENT", command.component, "the component")->required();
  tap.add_option("-n,--count", command.samples, "end after so many; without it: when interrupted")
      ->check(CLI::Range(std::int64_t{1}, std::int64_t{1'000'000'000}))
      ->type_name("N");
  tap.add_option("--rate", command.rate, "samples a second at most, of each task")
      ->check(CLI::Range(0.01, 1000.0))
      ->type_name("R");
  tap.add_option("--stream", command.stream, "only of this stream")->type_name("STREAM");
  auto& check =
      add(topology, command, Verb::topology_check, "check",
          "Check a topology's YAML file, and show its graph; asks no master", "iotcloud topology check follower.yaml");
  check.add_option("FILE", command.file, "the file")->required();
  check.remove_option(check.get_option("--output"));  // another program answers
}

/// "component=2" words. \throws CLI::ValidationError
std::map<std::string, int> parallelism_of(const std::vector<std::string>& words) {
  std::map<std::string, int> out;
  for (const auto& [component, count] : pairs(words, "COMPONENT=N")) {
    if (!CLI::detail::lexical_cast(count, out[component]) || out[component] < 1)
      throw CLI::ValidationError("COMPONENT=N", component + "=" + count + ": N is a whole number from 1 on");
  }
  return out;
}

/// Who one is to the masters. \throws CLI::ParseError
void identify(Command& command, const Words& words) {
  const char* token = std::getenv("IOTCLOUD_TOKEN");
  if (!words.token_file.empty()) {
    command.token = first_line(words.token_file);
  } else if (token != nullptr) {
    command.token = token;
  }
  const auto& tls = command.tls;
  if (tls.empty() || (!tls.ca.empty() && !tls.certificate.empty() && !tls.key.empty())) return;
  throw CLI::ValidationError("--ca, --certificate, --key", "give all three, or none: a master asks for a certificate");
}

/// Ids and KEY=VALUE words as they come. \throws CLI::ParseError
void describe(Command& command, const Words& words) {
  std::vector<std::string> changes;
  for (const auto& word : words.description) {
    (word.find('=') == std::string::npos ? command.instances : changes).push_back(word);
  }
  if (changes.empty()) throw CLI::RequiredError("KEY=VALUE");
  command.metadata = pairs(changes, "KEY=VALUE");
}

/// An order is for ids or for what the options choose; for all only when that is said. \throws CLI::ParseError
void check_choice(const Command& command, const Words& words) {
  const bool chosen =
      words.all || !command.name.empty() || !command.driver.empty() || !command.state.empty() || !command.where.empty();
  if (command.instances.empty() && !chosen)
    throw CLI::RequiredError("ID, or --where, --name, --driver, --state or --all,");
  if (!command.instances.empty() && chosen)
    throw CLI::ValidationError("ID", "give ids, or --where, --name, --driver, --state or --all, not both");
}

/// What channels are to do becomes properties. \throws CLI::ValidationError
void add_channels(Command& command, const std::map<std::string, std::string>& settings) {
  for (const auto& [setting, value] : settings) {
    auto problem = channel_setting_problem(setting, value);
    const auto dot = setting.rfind('.');
    const auto property =
        dot == std::string::npos ? setting : channel_property(setting.substr(0, dot), setting.substr(dot + 1));
    if (problem.empty() && !command.properties.emplace(property, value).second)
      problem = property + " is given as a --property too";
    if (!problem.empty()) throw CLI::ValidationError("--channel", problem);
  }
  for (const auto& [setting, value] : settings) {
    const auto dot = setting.rfind('.');
    const auto when_full = command.properties.find(channel_property(setting.substr(0, dot), "when_full"));
    const auto problem =
        spool_option_problem(setting.substr(dot + 1), when_full == command.properties.end() ? "" : when_full->second);
    if (!problem.empty()) throw CLI::ValidationError("--channel", problem);
  }
}

/// What the options cannot check one by one. \throws CLI::ParseError
void finish(Command& command, const Words& words) {
  if (command.verb == Verb::deploy && command.gateways.empty() && !words.all)
    throw CLI::RequiredError("--gateway GATEWAY or --all");
  command.properties = pairs(words.properties, "--property");
  add_channels(command, pairs(words.channels, "--channel"));
  if (command.verb == Verb::drain && words.undo) command.verb = Verb::undrain;
  command.metadata = pairs(words.metadata, "--metadata");
  if ((command.verb == Verb::deploy || command.verb == Verb::update) && command.plugin.empty())
    throw CLI::RequiredError("--plugin");
  if (command.verb == Verb::metadata) describe(command, words);
  if (command.verb == Verb::metadata || command.verb == Verb::update || command.verb == Verb::undeploy ||
      command.verb == Verb::start || command.verb == Verb::stop)
    check_choice(command, words);
  command.parallelism = parallelism_of(words.parallelism);
  command.settle_ms = static_cast<std::int64_t>(words.settle_s * 1000);
  command.drain_ms = static_cast<std::int64_t>(words.drain_s * 1000);
  identify(command, words);
  command.wait_ms = static_cast<std::int64_t>(words.wait_s * 1000);
}

void add_changes(CLI::App& app, Command& command, Words& words) {
  const auto choose = [&](CLI::App& sub) {
    add_gateways(sub, command, "the instances must be on one of these gateways");
    add_choice(sub, command);
    sub.add_flag("--all", words.all, "all instances, or all on the gateways that are named");
    add_wait(sub, words);
  };
  const auto change = [&](Verb verb, const char* name, const char* what, const char* example) -> CLI::App& {
    auto& sub = add(app, command, verb, name, what, example);
    sub.add_option("ID", command.instances, "ids of instances, or how they begin");
    choose(sub);
    return sub;
  };
  change(Verb::undeploy, "undeploy", "Take driver instances away", "iotcloud undeploy --state failed --gateway lab1");
  change(Verb::start, "start", "Let driver instances produce again", "iotcloud start 3f2a9c");
  auto& metadata =
      add(app, command, Verb::metadata, "metadata",
          "Change what others see in the records of driver instances. What a driver says of itself goes before",
          "iotcloud metadata 3f2a9c site=lab 'location=39.17,-86.52' note=");
  metadata
      .add_option("ID KEY=VALUE", words.description,
                  "ids of instances, or how they begin, and what to change; \"KEY=\" takes the key away")
      ->required();
  choose(metadata);
  auto& update =
      change(Verb::update, "update",
             "Give driver instances another version of their plugin, one gateway after the other. When one does "
             "not come up with it, all go back to the version before",
             "iotcloud update --plugin ./turtle-2.so --driver turtle");
  add_plugin(update, command);
  update.add_option("--at-once", command.at_once, "so many instances in one step, not all of one gateway")
      ->check(CLI::Range(1, 10'000))
      ->type_name("N");
  add_settle(update, words);
  change(Verb::stop, "stop", "Let driver instances pause; they stay deployed",
         "iotcloud stop 3f2a9c 77b1\n  iotcloud stop --where 'site == \"lab\"'");
}

void add_signing(CLI::App& app, Command& command) {
  auto& keys = *app.add_subcommand("keys", "Keys with which plugins are signed");
  keys.require_subcommand(1);
  auto& make = add(keys, command, Verb::keys_new, "new",
                   "Make a pair of Ed25519 keys: PATH.key signs, and is yours alone; PATH.pub is for the gateways",
                   "iotcloud keys new ~/keys/lab");
  make.add_option("PATH", command.file, "how the files' names begin")->required();
  auto& sign = add(app, command, Verb::sign, "sign", "Sign a plugin: writes FILE.sig, which goes where FILE goes",
                   "iotcloud sign turtle.so --key ~/keys/lab.key");
  sign.add_option("FILE", command.file, "the plugin")->required();
  sign.add_option("--key", command.key, "a private Ed25519 key in PEM")->required()->type_name("KEY");
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGPIPE, SIG_IGN);  // a broken connection is an error with a text
  Command command;
  Words words;
  command.masters = {"127.0.0.1:12904"};
  CLI::App app{"Runs a fleet of IoTCloud gateways, and topologies, through their master.", "iotcloud"};
  app.footer(footer);
  app.require_subcommand(1);
  app.fallthrough();
  app.set_version_flag("--version", std::string("iotcloud ") + iotcloud::config::version);
  app.add_option("--master", command.masters, "where a master is; several: the first that answers")
      ->envname("IOTCLOUD_MASTER")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("HOST:PORT,...")
      ->default_str("127.0.0.1:12904");
  app.add_option("--token-file", words.token_file, "file whose first line is the master's token")
      ->envname("IOTCLOUD_TOKEN_FILE")
      ->type_name("FILE");
  const auto add_identity = [&](const char* option, std::string& file, const char* what, const char* variable) {
    app.add_option(option, file, what)->envname(variable)->type_name("FILE");
  };
  add_identity("--ca", command.tls.ca, "whom to trust: speak TLS with the masters", "IOTCLOUD_CA");
  add_identity("--certificate", command.tls.certificate, "the certificate to show them", "IOTCLOUD_CERTIFICATE");
  add_identity("--key", command.tls.key, "its private key", "IOTCLOUD_KEY");
  add_reads(app, command);
  add_deploy(app, command, words);
  add_changes(app, command, words);
  add_fleet(app, command, words);
  add_topology(app, command, words);
  add_signing(app, command);
  add_security(app, command);
  add_completion(app, words);
  if (argc > 1 && argv[1] == std::string("__complete")) {
    return answer_shell(app, {argv + 2, argv + argc}, [&] {
      finish(command, words);
      return command;
    });
  }
  command.progress = isatty(STDERR_FILENO) != 0;
  try {
    app.parse(argc, argv);
    finish(command, words);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? exit_ok : exit_usage;
  }
  if (!words.shell.empty()) return print_completion(words.shell, std::cout);
  if (command.verb == Verb::topology_tap || command.follow || command.watch_s > 0)
    std::signal(SIGINT, [](int) { interrupt(); });
  return run(command, std::cout, std::cerr);
}
