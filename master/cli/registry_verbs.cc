// registry adopt
#include <CLI/CLI.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/order_verbs.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

namespace {

class Adopt final : public Verb {
 public:
  Adopt()
      : Verb({"adopt",
              "Say that the registry's orders are meant as they stand, to gateways that are frozen because it was "
              "emptied "
              "or put back to an earlier state: they undeploy what is not ordered, and follow orders again",
              "iotcloud registry adopt lab1\n  iotcloud registry adopt --all", security::Role::admin}) {}

  void declare(CLI::App& options) override {
    auto* ids = options.add_option("GATEWAY", selection_.gateways, "ids of gateways");
    options.add_flag("--all", all_, "all gateways that are frozen")->excludes(ids);
    add_wait(options, selection_.wait);
  }
  void check() override {
    if (selection_.gateways.empty() && !all_) throw CLI::RequiredError("GATEWAY or --all");
  }
  int run(Call& call) override {
    const auto master = call.connect();
    const std::string order = discovery::to_json<nlohmann::ordered_json>(selection_).dump();
    return show_order(call, master->give("adopt", order, selection_.wait));
  }

 private:
  GatewaySelection selection_;
  bool all_ = false;
};

}  // namespace

void add_registry_verbs(Verbs& verbs) {
  verbs.group("registry", "The registry after an accident").add<Adopt>();
}

}  // namespace iotcloud::master::cli
