// iotcloud-storm: topologies on Apache Storm; `iotcloud topology pack` starts it.
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iostream>
#include <optional>
#include <set>

#include <CLI/CLI.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/output/watch.h>
#include <iotcloud/topology/storm/storm_verbs.h>

namespace {

namespace output = iotcloud::config::output;
namespace storm = iotcloud::topology::storm;
using std::chrono::seconds;

/// The component libraries of the build and of the installation.
std::vector<std::string> library_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
}

/// "COMPONENT=EXECUTORS". \throws config::Error for another text.
std::map<std::string, int> executors_of(const std::vector<std::string>& words) {
  std::map<std::string, int> executors;
  for (const auto& word : words) {
    const auto equals = word.rfind('=');
    const std::string number = equals == std::string::npos ? "" : word.substr(equals + 1);
    const bool digits =
        !number.empty() && number.size() < 6 && number.find_first_not_of("0123456789") == std::string::npos;
    if (equals == 0 || !digits)
      throw iotcloud::config::Error("\"" + word + "\" is not of the form COMPONENT=EXECUTORS, such as count=4");
    executors[word.substr(0, equals)] = std::stoi(number);
  }
  return executors;
}

/// "LOGGER=LEVEL", or "LOGGER=". \throws config::Error for another text.
std::map<std::string, std::string> levels_of(const std::vector<std::string>& words) {
  static const std::set<std::string> known{"", "ALL", "TRACE", "DEBUG", "INFO", "WARN", "ERROR", "FATAL", "OFF"};
  std::map<std::string, std::string> levels;
  for (const auto& word : words) {
    const auto equals = word.rfind('=');
    const std::string level = equals == std::string::npos ? "" : word.substr(equals + 1);
    if (equals == 0 || equals == std::string::npos || !known.contains(level)) {
      throw iotcloud::config::Error("\"" + word +
                                    "\" is not of the form LOGGER=LEVEL, such as iotcloud=DEBUG (TRACE, DEBUG, INFO, "
                                    "WARN, ERROR, OFF), or LOGGER= for the level of before");
    }
    levels[word.substr(0, equals)] = level;
  }
  return levels;
}

/// The words of the command line, and the verb that they name.
struct Words {
  storm::StormCall call{.nimbus = {}, .folders = {}, .out = std::cout};
  std::string file;
  std::string jar;
  std::string onto;
  std::string name;
  std::string window = ":all-time";
  std::vector<std::string> executors;
  std::vector<std::string> levels;
  std::optional<int> workers;
  int patience_s = 30;
  int limit_s = 120;
  int wait_s = 30;
  int time_out_s = 0;
  double watch_s = 0;
  std::function<int()> verb;

  CLI::App* add(CLI::App& app, const char* name_of_verb, const char* what, std::function<int()> run) {
    CLI::App* made = app.add_subcommand(name_of_verb, what);
    made->callback([this, run = std::move(run)] {
      verb = [this, run] {
        call.patience = seconds(patience_s);
        return run();
      };
    });
    return made;
  }
  CLI::App* of_cluster(CLI::App* made) {
    made->add_option("--nimbus", call.nimbus, "HOST:PORT of Storm's Nimbus; several with commas")->delimiter(',');
    made->add_option("--patience", patience_s,
                     "seconds in which a Nimbus must lead: after a failover, or when the one that leads fails")
        ->check(CLI::Range(0, 3600));
    made->add_option_function<std::string>(
            "-o,--output",
            [this](const std::string& word) {
              call.format = word == "json"   ? output::Format::json
                            : word == "yaml" ? output::Format::yaml
                                             : output::Format::table;
            },
            "how the answer is written")
        ->check(CLI::IsMember({"table", "json", "yaml"}))
        ->type_name("FORMAT");
    return made;
  }
  CLI::App* watched(CLI::App* made) {
    made->add_option("--watch", watch_s, "again every so many seconds until interrupted; 1 when none are given")
        ->expected(0, 1)
        ->default_str("1")
        ->check(CLI::Range(0.1, 3600.0))
        ->type_name("SECONDS");
    return made;
  }
  CLI::App* of_topology(CLI::App* made) {
    of_cluster(made)->add_option("NAME", name, "the topology")->required();
    return made;
  }
  void declare(CLI::App& app);
};

void Words::declare(CLI::App& app) {
  const auto with_file = [&](CLI::App* made) {
    made->add_option("FILE", file, "the topology's YAML file")->required()->check(CLI::ExistingFile);
    return made;
  };
  CLI::App* pack =
      add(app, "pack", "make a jar of a topology, or of a component library for Flux and Java, for `storm jar`",
          [&] { return storm::pack(call, file, jar, onto); });
  pack->add_option("FILE", file, "the topology's YAML file, or a component library (.so)")
      ->required()
      ->check(CLI::ExistingFile);
  pack->add_option("JAR", jar, "the jar")->required();
  pack->add_option("--onto", onto, "a jar that is taken along, with components in Java and Python, and Flux")
      ->check(CLI::ExistingFile);
  CLI::App* submit = of_cluster(with_file(add(app, "submit", "send a topology to Storm, and wait until it runs",
                                              [&] { return storm::submit(call, file, workers, seconds(limit_s)); })));
  submit->add_option("--workers", workers, "worker processes")->check(CLI::Range(1, 10'000));
  watched(of_cluster(add(app, "list", "the topologies of the cluster", [&] { return storm::list(call, watch_s); })));
  of_topology(add(app, "show", "a topology's workers, components and executors, and where they run",
                  [&] { return storm::show(call, name); }));
  watched(of_topology(add(app, "metrics", "counts of a topology's components, as often as Storm's workers report them",
                          [&] { return storm::metrics(call, name, window, watch_s); })))
      ->add_option("--window", window, "of the last 600, 10800 or 86400 seconds, or :all-time");
  of_topology(
      add(app, "errors", "errors that a topology's components reported", [&] { return storm::errors(call, name); }));
  of_topology(add(app, "activate", "let the spouts go on", [&] { return storm::set_active(call, name, true); }));
  of_topology(add(app, "deactivate", "let the spouts pause", [&] { return storm::set_active(call, name, false); }));
  CLI::App* rebalance =
      of_topology(add(app, "rebalance", "change the number of workers or executors, and wait until they run", [&] {
        return storm::rebalance(call, name, workers, executors_of(executors), seconds(wait_s), seconds(limit_s));
      }));
  rebalance->add_option("COMPONENT=EXECUTORS", executors, "how many tasks of a component may run at the same time");
  rebalance->add_option("--workers", workers, "worker processes")->check(CLI::Range(1, 10'000));
  CLI::App* set_log_level = of_topology(add(app, "set_log_level", "change what the workers log", [&] {
    return storm::set_log_levels(call, name, levels_of(levels), seconds(time_out_s));
  }));
  set_log_level->add_option("LOGGER=LEVEL", levels, "iotcloud=DEBUG for what this project logs")->required();
  set_log_level->add_option("--time-out", time_out_s, "seconds after which the levels are as before; 0: none")
      ->check(CLI::Range(0, 86'400));
  CLI::App* kill =
      of_topology(add(app, "kill", "end a topology", [&] { return storm::kill(call, name, seconds(wait_s)); }));
  for (CLI::App* made : {submit, rebalance}) {
    made->add_option("--limit", limit_s, "seconds in which all tasks must run; 0: do not wait")
        ->check(CLI::Range(0, 3600));
  }
  for (CLI::App* made : {rebalance, kill}) {
    made->add_option("--wait", wait_s, "seconds in which what is under way may be finished, before the workers end")
        ->check(CLI::Range(0, 3600));
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Runs topologies on Apache Storm: packs, submits, lists and ends them.", "iotcloud-storm"};
  app.require_subcommand(1);
  iotcloud::config::set_log_level(iotcloud::config::LogLevel::error);  // notes are for people, other lines for daemons
  Words words;
  words.call.folders = library_folders();
  words.declare(app);
  CLI11_PARSE(app, argc, argv);
  if (words.watch_s > 0) std::signal(SIGINT, [](int) { output::interrupt(); });
  try {
    return words.verb();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-storm: %s\n", error.what());
    return 1;
  }
}
