// topology pack: no master is asked
#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/topology/pack_verb.h>

namespace iotcloud::master::cli {

namespace {

class Pack final : public Verb {
 public:
  Pack()
      : Verb({"pack",
              "Make a jar of a topology with its component libraries and all that they need, for `storm jar`: Storm's "
              "own client submits it, with Kerberos or TLS. In place of a topology, a component library: its classes "
              "are "
              "for Flux and Java",
              "iotcloud topology pack count.yaml count.jar && storm jar count.jar", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the topology's YAML file, or a component library (.so)")
        ->required()
        ->type_name("FILE");
    options.add_option("JAR", jar_, "the jar")->required()->type_name("FILE");
    options.add_option("--onto", onto_, "a jar that is taken along, with components in Java and Python, and Flux")
        ->type_name("JAR");
  }
  int run(Call&) override {
    std::vector<std::string> words{"pack", file_, jar_};
    if (!onto_.empty()) words.insert(words.end(), {"--onto", onto_});
    become_sibling("iotcloud-storm", words);
  }

 private:
  std::string file_;
  std::string jar_;
  std::string onto_;
};

}  // namespace

std::unique_ptr<Verb> pack_topology_verb() {
  return std::make_unique<Pack>();
}

}  // namespace iotcloud::master::cli
