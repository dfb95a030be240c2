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
              "own "
              "client submits it, with Kerberos or TLS",
              "iotcloud topology pack count.yaml count.jar && storm jar count.jar", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the topology's YAML file")->required()->type_name("FILE");
    options.add_option("JAR", jar_, "the jar")->required()->type_name("FILE");
  }
  int run(Call&) override { become_sibling("iotcloud-storm", {"pack", file_, jar_}); }

 private:
  std::string file_;
  std::string jar_;
};

}  // namespace

std::unique_ptr<Verb> pack_topology_verb() {
  return std::make_unique<Pack>();
}

}  // namespace iotcloud::master::cli
