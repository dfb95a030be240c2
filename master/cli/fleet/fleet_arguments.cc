#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/fleet/fleet_arguments.h>

namespace iotcloud::master::cli {

namespace {

void add_manifest(CLI::App& sub, Command& command) {
  sub.add_option("-f,--file", command.file, "the manifest; config/fleet.yaml is a commented one")
      ->required()
      ->type_name("FILE");
  sub.add_flag_callback(
      "--no-prune", [&command] { command.prune = false; },
      "leave what an earlier apply of this manifest deployed and it does not name any more");
  sub.add_flag("--adopt", command.adopt,
               "take instances over that others deployed under names of the manifest; without it they are left alone");
}

void add_gateway_names(CLI::App& sub, Command& command, Words& words) {
  sub.add_option("GATEWAY", command.gateways, "ids of gateways")->required();
  add_wait(sub, words);
}

}  // namespace

void add_fleet(CLI::App& app, Command& command, Words& words) {
  add_manifest(
      add(app, command, Verb::diff, "diff", "Show what apply would change; exit status 4 when there is something",
          "iotcloud diff -f fleet.yaml"),
      command);
  auto& apply =
      add(app, command, Verb::apply, "apply",
          "Make the fleet as a manifest says: deploy what is missing, change what differs, undeploy what an "
          "earlier apply of it deployed and it does not name any more. Nothing else is touched. Another plugin "
          "comes to one gateway after the other, and when one does not come up with it, all go back",
          "iotcloud apply -f fleet.yaml");
  add_manifest(apply, command);
  apply.add_flag("--dry-run", command.dry_run, "only show what would change, as diff");
  add_wait(apply, words);
  add_settle(apply, words);
  auto& drain = add(app, command, Verb::drain, "drain",
                    "Stop all instances of gateways, and deploy nothing on them any more, until: iotcloud undrain",
                    "iotcloud drain lab1");
  add_gateway_names(drain, command, words);
  drain.add_flag("--undo", words.undo, "the same as undrain");
  add_gateway_names(add(app, command, Verb::undrain, "undrain",
                        "Let gateways work again: what drain stopped starts, what had been stopped before stays so",
                        "iotcloud undrain lab1"),
                    command, words);
}

}  // namespace iotcloud::master::cli
