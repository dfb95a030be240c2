#include <csignal>
#include <cstdlib>
#include <fstream>
#include <ostream>

#include <CLI/CLI.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/version.h>
#include <iotcloud/master/cli/completion.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/program.h>

namespace iotcloud::master::cli {

namespace {

constexpr const char* footer =
    "Exit status: 0 done; 1 failed, for all or for some, or the outcome is not known; 2 wrong usage, or a manifest "
    "that\n"
    "cannot be used; 3 no master answers; 4 diff and apply --dry-run: the fleet is not as the manifest says.\n"
    "Environment: IOTCLOUD_MASTER as --master; IOTCLOUD_CA, IOTCLOUD_CERTIFICATE, IOTCLOUD_KEY and IOTCLOUD_REVOKED "
    "as --ca, --certificate, --key and --revoked; IOTCLOUD_TOKEN_FILE as --token-file, or the token itself in "
    "IOTCLOUD_TOKEN.";

void declare(CLI::App& app, Call& call, std::string& token_file) {
  app.footer(footer);
  app.require_subcommand(1);
  app.fallthrough();
  app.set_version_flag("--version", std::string("iotcloud ") + config::version);
  app.add_option("--master", call.masters, "where a master is; several: the first that answers")
      ->envname("IOTCLOUD_MASTER")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("HOST:PORT,...")
      ->default_str("127.0.0.1:12904");
  const auto add_file = [&](const char* option, std::string& file, const char* what, const char* variable) {
    app.add_option(option, file, what)->envname(variable)->type_name("FILE");
  };
  add_file("--token-file", token_file, "file whose first line is the master's token", "IOTCLOUD_TOKEN_FILE");
  auto& tls = call.access.tls;
  add_file("--ca", tls.ca, "the certificate of the masters' authority: speak TLS with them", "IOTCLOUD_CA");
  add_file("--certificate", tls.certificate, "the certificate to show them", "IOTCLOUD_CERTIFICATE");
  add_file("--key", tls.key, "its private key", "IOTCLOUD_KEY");
  add_file("--revoked", tls.revoked, "masters whose certificates are on this list are not spoken with (revoked.pem)",
           "IOTCLOUD_REVOKED");
}

/// Reads the credentials for the masters. \throws CLI::ParseError
void identify(Call& call, const std::string& token_file) {
  const char* token = std::getenv("IOTCLOUD_TOKEN");
  if (!token_file.empty()) {
    std::ifstream in(token_file);
    if (!std::getline(in, call.access.token))
      throw CLI::ValidationError("--token-file", "cannot read a line from " + token_file);
  } else if (token != nullptr) {
    call.access.token = token;
  }
  const auto& tls = call.access.tls;
  if (tls == security::TlsFiles{} || (!tls.ca.empty() && !tls.certificate.empty() && !tls.key.empty())) return;
  throw CLI::ValidationError("--ca, --certificate, --key",
                             "give all three, or none and no --revoked: a master asks for a certificate");
}

/// Runs a verb. An error becomes a message and an exit status.
int run(Verb& verb, Call& call) {
  const auto complain = [&](const std::exception& error, ExitStatus status) -> int {
    call.err << "iotcloud: " << error.what() << '\n';
    return status;
  };
  try {
    return verb.run(call);
  } catch (const AmbiguousId& e) {
    return complain(e, exit_usage);
  } catch (const config::ConfigError& e) {
    return complain(e, exit_usage);
  } catch (const std::invalid_argument& e) {
    return complain(e, exit_usage);
  } catch (const Unreachable& e) {
    return complain(e, exit_unreachable);
  } catch (const config::Error& e) {
    return complain(e, exit_failed);
  } catch (const RequestFailed& e) {
    return complain(e, exit_failed);
  }
}

}  // namespace

int run_program(const std::vector<std::string>& words, Call& call) {
  std::string token_file;
  CLI::App app{"Runs a fleet of IoTCloud gateways, and topologies, through their master.", "iotcloud"};
  declare(app, call, token_file);
  Verbs verbs(app, call.format);
  for (const auto add_family : families) add_family(verbs);
  if (!words.empty() && words.front() == "__complete") {
    return answer_shell(app, {words.begin() + 1, words.end()}, call, [&] { identify(call, token_file); });
  }
  try {
    app.parse(std::vector<std::string>(words.rbegin(), words.rend()));
    verbs.chosen()->check();
    identify(call, token_file);
  } catch (const CLI::ParseError& e) {
    return app.exit(e, call.out, call.err) == 0 ? exit_ok : exit_usage;
  }
  auto& verb = *verbs.chosen();
  if (verb.goes_on()) std::signal(SIGINT, [](int) { interrupt(); });
  return run(verb, call);
}

}  // namespace iotcloud::master::cli
