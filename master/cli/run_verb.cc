// run: no master is asked
#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

namespace {

class Run final : public Verb {
 public:
  Run()
      : Verb({"run",
              "Run a topology and its drivers in one process, with nothing installed: broker and registry are "
              "embedded. Shows "
              "each second what came and went, starts anew when a library or the file changes; Ctrl-C ends it",
              "iotcloud run topology.yaml --plugin ./weather.so -n 5 --property rate=10", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the topology's YAML file")->required()->type_name("FILE");
    add(options, "--plugin", "a driver's plugin; again for each further one, all in one folder", "FILE");
    add(options, "-n,--count", "instances of each plugin", "N");
    add(options, "--property", "for all instances, {index} in it for each one's number; again for each further one",
        "KEY=VALUE");
    add(options, "--broker", "a broker's URL in place of the embedded one", "URL");
    add(options, "--registry", "a registry's URL in place of the embedded one", "URL");
    add(options, "--seconds", "end after so many", "N");
    add(options, "--stop-limit", "the longest time from then on until all is stopped (5)", "SECONDS");
    add(options, "--view", "where a page shows all of it: 127.0.0.1:9114; port 0: a free one", "HOST:PORT");
    add(options, "--pages", "a folder of robots' pages for --view; again for each further one", "FOLDER");
    add(options, "--log-level", "debug, info, warn (as it is), error or off", "LEVEL");
  }
  int run(Call&) override {
    std::vector<std::string> words{file_};
    for (const auto& [name, values] : given_) {
      for (const auto& value : values) words.insert(words.end(), {name, value});
    }
    become_sibling("iotcloud-run", words);
  }

 private:
  void add(CLI::App& options, const std::string& name, const char* what, const char* type) {
    const std::string longest = name.substr(name.rfind(',') + 1);
    options.add_option(name, given_[longest], what)->type_name(type)->allow_extra_args(false);
  }

  std::string file_;
  std::map<std::string, std::vector<std::string>> given_;  ///< by option, as iotcloud-run takes them
};

}  // namespace

void add_run_verbs(Verbs& verbs) {
  verbs.add<Run>();
}

}  // namespace iotcloud::master::cli
