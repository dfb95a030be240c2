#include <algorithm>
#include <filesystem>
#include <ostream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/access/certificates.h>
#include <iotcloud/config/access/tokens.h>
#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/security/security_command.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;

namespace {

constexpr const char* usual_caller = "operator";

/// Nothing is made when something is there already. \throws config::Error
void check_free(const config::Authority& authority, const std::vector<std::string>& names) {
  for (const auto& name : names) {
    for (const auto& file : {authority.certificate(name), authority.key(name)}) {
      if (std::filesystem::exists(file))
        throw config::Error(
            fmt::format("{} is there already, and is not overwritten; take another folder, or another "
                        "name with `iotcloud certs add`",
                        file));
    }
  }
}

int make_certificates(const Command& command, std::ostream& out) {
  const config::Authority authority{std::filesystem::absolute(command.folder).lexically_normal().string()};
  const bool is_new = command.verb == Verb::certs_init;
  auto callers = command.callers;
  if (is_new) callers.emplace_back(usual_caller);
  auto names = command.hosts;
  names.insert(names.end(), callers.begin(), callers.end());
  if (is_new) names.emplace_back("ca");
  check_free(authority, names);
  if (is_new) authority.make();
  for (const auto& host : command.hosts) authority.certify_host(host);
  for (const auto& caller : callers) authority.certify_caller(caller);

  const auto& folder = authority.folder;
  if (is_new) {
    out << fmt::format(
        "{}/ca.pem       whom all trust: everybody gets a copy\n"
        "{}/ca.key       makes more certificates: keep it here, or better offline\n",
        folder, folder);
  }
  for (const auto& host : command.hosts)
    out << fmt::format("{0}/{1}.pem, {1}.key  for the daemons on {1}\n", folder, host);
  for (const auto& caller : callers)
    out << fmt::format("{0}/{1}.pem, {1}.key  for {1}, who calls them\n", folder, caller);
  out << "\nNext, on each machine: copy ca.pem and its own two files there, readable by its daemon only, and say in\n"
         "master.yaml below `api:`, in gateway.yaml below `thrift:`\n";
  const std::string host = command.hosts.empty() ? "HOST" : command.hosts.front();
  out << fmt::format(
      "  host: 0.0.0.0\n  advertise: \"{0}:PORT\"\n"
      "  tls: {{ca: {1}/ca.pem, certificate: {1}/{0}.pem, key: {1}/{0}.key}}\n"
      "  tokens: {1}/tokens\n",
      host, folder);
  out << fmt::format("Then:\n  iotcloud token add NAME --role admin --file {}/tokens\n", folder);
  out << fmt::format(
      "  iotcloud --master {0}:12904 --ca {1}/ca.pem --certificate {1}/{2}.pem --key {1}/{2}.key "
      "--token-file FILE status\n",
      host, folder, callers.empty() ? usual_caller : callers.front());
  return exit_ok;
}

int list_tokens(const Command& command, std::ostream& out) {
  const auto entries = config::read_tokens(command.file);
  if (command.format == Format::table) {
    std::vector<std::vector<std::string>> rows;
    rows.reserve(entries.size());
    for (const auto& entry : entries) rows.push_back({entry.name, to_string(entry.role)});
    print_table(out, {"NAME", "ROLE"}, rows);
    return exit_ok;
  }
  Json json = Json::array();
  for (const auto& entry : entries) json.push_back({{"name", entry.name}, {"role", to_string(entry.role)}});
  print_data(out, command.format, json);
  return exit_ok;
}

}  // namespace

bool is_security(Verb verb) {
  return verb == Verb::certs_init || verb == Verb::certs_add || verb == Verb::token_add || verb == Verb::token_remove ||
         verb == Verb::token_list;
}

int run_security(const Command& command, std::ostream& out) {
  switch (command.verb) {
    case Verb::token_add:
      // Alone on its line, so that a script can take it.
      out << config::add_token(command.file, command.token_name, config::parse_role(command.role)) << '\n';
      return exit_ok;
    case Verb::token_remove:
      if (!config::remove_token(command.file, command.token_name))
        throw config::Error(fmt::format("{} has no token of {}", command.file, command.token_name));
      return exit_ok;
    case Verb::token_list:
      return list_tokens(command, out);
    default:
      return make_certificates(command, out);
  }
}

}  // namespace iotcloud::master::cli
