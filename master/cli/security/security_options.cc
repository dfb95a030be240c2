#include <string>

#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/arguments.h>
#include <iotcloud/master/cli/security/security_options.h>

namespace iotcloud::master::cli {

namespace {

/// A verb whose answer is what it prints, in one format.
CLI::App& add_plain(CLI::App& group, Command& command, Verb verb, const char* name, const char* what,
                    const char* example) {
  auto& sub = add(group, command, verb, name, what, example);
  sub.remove_option(sub.get_option("--output"));
  return sub;
}

CLI::Option& add_hosts(CLI::App& sub, Command& command) {
  sub.add_option("DIR", command.folder, "the folder of the authority and its certificates")->required();
  return *sub.add_option("--host", command.hosts, "machines with daemons, by the names that clients use")
              ->delimiter(',')
              ->type_name("HOST");
}

void add_certs(CLI::App& app, Command& command) {
  auto& certs = *app.add_subcommand("certs", "Make certificates for a small installation; asks no master");
  certs.require_subcommand(1);
  add_hosts(
      add_plain(certs, command, Verb::certs_init, "init",
                "Make an authority, a certificate for each machine with a master or gateways, and one for an operator. "
                "Overwrites nothing, and says what to do next",
                "iotcloud certs init certs --host lab1 lab2"),
      command)
      .required();
  auto& more = add_plain(certs, command, Verb::certs_add, "add", "Make more certificates of an authority",
                         "iotcloud certs add certs --host lab3\n  iotcloud certs add certs --caller anna");
  add_hosts(more, command);
  more.add_option("--caller", command.callers, "people and programs that call daemons")
      ->delimiter(',')
      ->type_name("CALLER");
  more.require_option(2, 0);  // DIR, and for whom
}

void add_tokens(CLI::App& app, Command& command) {
  auto& token = *app.add_subcommand("token", "Keep a file of tokens, which a daemon reads; asks no master");
  token.require_subcommand(1);
  const auto add_file = [&](CLI::App& sub) {
    sub.add_option("--file", command.file, "the token file")->required()->type_name("FILE");
  };
  auto& make = add_plain(token, command, Verb::token_add, "add",
                         "Make a token and print it: it is shown this once, and only its hash is kept",
                         "iotcloud token add anna --role operator --file tokens > anna.token");
  make.add_option("HOLDER", command.token_name, "whose: what the audit log calls them")->required();
  make.add_option("--role", command.role,
                  "viewer: reads; operator: also starts, stops and describes; admin: everything")
      ->required()
      ->check(CLI::IsMember({"viewer", "operator", "admin"}))
      ->type_name("ROLE");
  add_file(make);
  auto& remove = add_plain(token, command, Verb::token_remove, "remove",
                           "Take a token away; daemons notice at SIGHUP (systemctl reload)",
                           "iotcloud token remove anna --file tokens");
  remove.add_option("HOLDER", command.token_name, "whose")->required();
  add_file(remove);
  auto& list = add(token, command, Verb::token_list, "list", "List whose tokens there are, with their roles",
                   "iotcloud token list --file tokens");
  add_file(list);
}

}  // namespace

void add_security(CLI::App& app, Command& command) {
  add_certs(app, command);
  add_tokens(app, command);
}

}  // namespace iotcloud::master::cli
