// certs ..., token ..., audit ...: files of this machine, for which no master is asked
#include <algorithm>
#include <filesystem>
#include <ostream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/security/audit_chain.h>
#include <iotcloud/security/certificates.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/security/tls.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;

namespace {

constexpr const char* usual_caller = "operator";

/// Checks that none of the files exists yet, before the first one is made. \throws config::Error
void check_free(const security::Authority& authority, const std::vector<std::string>& names) {
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

/// `certs init` makes an authority and its first certificates, `certs add` makes more.
class Certs final : public Verb {
 public:
  explicit Certs(bool is_new)
      : Verb(is_new ? Card{"init",
                           "Make an authority, a certificate for each machine with a master or gateways, and one for "
                           "an operator. Overwrites nothing, and says what to do next",
                           "iotcloud certs init certs --host lab1 lab2", std::nullopt, false}
                    : Card{"add", "Make more certificates of an authority",
                           "iotcloud certs add certs --host lab3\n"
                           "  iotcloud certs add certs --host lab3 --daemon lab3-gateway --gateway gateway-3\n"
                           "  iotcloud certs add certs --host lab3 --daemon lab3-pool --pool pool-3\n"
                           "  iotcloud certs add certs --caller anna",
                           std::nullopt, false}),
        is_new_(is_new) {}

  void declare(CLI::App& options) override {
    options.add_option("DIR", folder_, "the folder of the authority and its certificates")->required();
    auto& hosts = *options.add_option("--host", hosts_, "machines with daemons, by the names that clients use")
                       ->delimiter(',')
                       ->type_name("HOST");
    options
        .add_option("--gateway", named_.gateways,
                    "the gateways on that machine, by their ids: a master sends its token only to a gateway that the "
                    "certificate names. Not needed for one that is named as its machine")
        ->delimiter(',')
        ->type_name("ID");
    options
        .add_option("--pool", named_.pools,
                    "the pools of workers on that machine, by their ids, as for gateways: also libraries go only to a "
                    "pool that the certificate names")
        ->delimiter(',')
        ->type_name("ID");
    if (is_new_) {
      hosts.required();
      return;
    }
    options
        .add_option("--daemon", daemon_,
                    "one certificate for one of that machine's daemons, by this name: on a machine with several, who "
                    "takes over one has not those of the others. --host then gives all names of that one machine")
        ->needs(&hosts)
        ->type_name("NAME");
    options.add_option("--caller", callers_, "people and programs that call daemons")
        ->delimiter(',')
        ->type_name("CALLER");
    options.require_option(2, 0);  // DIR, and at least one host or user
  }

  int run(Call& call) override {
    const security::Authority authority{std::filesystem::absolute(folder_).lexically_normal().string()};
    auto callers = callers_;
    if (is_new_) callers.emplace_back(usual_caller);
    const auto servers = daemon_.empty() ? hosts_ : std::vector{daemon_};
    auto names = servers;
    names.insert(names.end(), callers.begin(), callers.end());
    if (is_new_) names.emplace_back("ca");
    check_free(authority, names);
    if (!(named_.gateways.empty() && named_.pools.empty()) && servers.size() != 1)
      throw config::Error(
          "--gateway and --pool name the daemons of one machine: give one --host, and `certs add` the others");
    if (is_new_) {
      authority.make();
      security::make_revocations(authority);
    }
    if (daemon_.empty()) {
      for (const auto& host : hosts_) authority.certify_host(host, named_);
    } else {
      authority.certify_daemon(daemon_, hosts_, named_);
    }
    for (const auto& caller : callers) authority.certify_caller(caller);

    const auto& folder = authority.folder;
    if (is_new_) {
      call.out << fmt::format(
          "{}/ca.pem       whom all trust: everybody gets a copy\n"
          "{}/ca.key       makes more certificates: keep it here, or better offline\n",
          folder, folder);
    }
    for (const auto& server : servers)
      call.out << fmt::format("{0}/{1}.pem, {1}.key  for {2}{1}\n", folder, server,
                              daemon_.empty() ? "the daemons on " : "");
    for (const auto& caller : callers)
      call.out << fmt::format("{0}/{1}.pem, {1}.key  for {1}, who calls them\n", folder, caller);
    call.out
        << "\nNext, on each machine: copy ca.pem and its own two files there, readable by its daemon only, and say in\n"
           "master.yaml below `api:`, in gateway.yaml below `thrift:`\n";
    const std::string host = hosts_.empty() ? "HOST" : hosts_.front();
    call.out << fmt::format(
        "  host: 0.0.0.0\n  advertise: \"{0}:PORT\"\n"
        "  tls: {{ca: {1}/ca.pem, certificate: {1}/{2}.pem, key: {1}/{2}.key}}\n"
        "  tokens: {1}/tokens\n",
        host, folder, servers.empty() ? host : servers.front());
    call.out << fmt::format(
        "Then:\n  iotcloud token add NAME --role admin --certificate {1}/{2}.pem --file {1}/tokens\n"
        "  iotcloud --master {0}:12904 --ca {1}/ca.pem --certificate {1}/{2}.pem --key {1}/{2}.key "
        "--token-file FILE status\n",
        host, folder, callers.empty() ? usual_caller : callers.front());
    return exit_ok;
  }

 private:
  const bool is_new_;
  std::string folder_;
  std::vector<std::string> hosts_;
  std::string daemon_;                ///< whose certificate it is, if not that of all daemons on the host
  security::NamedIds named_;          ///< on the one machine
  std::vector<std::string> callers_;  ///< users, whose certificates are for clients only
};

/// `certs renew` and `certs revoke`: a verb about certificates that are there.
class OfCertificates : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    options.add_option("DIR", folder_, "the folder of the authority and its certificates")->required();
    options.add_option("HOLDER", holders_, "the names of their files, without .pem")->required();
  }

 protected:
  security::Authority authority() const { return {std::filesystem::absolute(folder_).lexically_normal().string()}; }
  std::string folder_;
  std::vector<std::string> holders_;
};

class RenewCertificates final : public OfCertificates {
 public:
  RenewCertificates()
      : OfCertificates({"renew",
                        "Make certificates anew, for the same keys, before they expire. Copy them to their machines: "
                        "daemons take them within seconds, without a restart. A holder whose certificate is revoked "
                        "needs a new key",
                        "iotcloud certs renew certs lab1 lab2\n  iotcloud certs renew certs lab2 --new-key",
                        std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    OfCertificates::declare(options);
    options.add_option("--days", days_, "how long they are valid")->check(CLI::Range(1, 3650))->type_name("N");
    options.add_flag("--new-key", new_key_, "make new keys, too, because the old ones may have been stolen");
  }
  int run(Call& call) override {
    const auto key = new_key_ ? security::RenewedKey::new_one : security::RenewedKey::same;
    for (const auto& holder : holders_) {
      security::renew_certificate(authority(), holder, days_, key);
      call.out << fmt::format("{}: valid for {} days\n", authority().certificate(holder), days_);
    }
    return exit_ok;
  }

 private:
  int days_ = security::usual_days;
  bool new_key_ = false;
};

class RevokeCertificates final : public OfCertificates {
 public:
  RevokeCertificates()
      : OfCertificates({"revoke",
                        "Put certificates, and those that they replaced, on the list DIR/revoked.pem. Daemons whose "
                        "files name a copy of it (tls: "
                        "{revoked: ...}) refuse them within seconds, also on open connections",
                        "iotcloud certs revoke certs lab2", std::nullopt, false}) {}
  int run(Call& call) override {
    for (const auto& holder : holders_) security::revoke_certificate(authority(), holder);
    call.out << fmt::format("{}: copy it to each machine with a daemon\n", security::revocations_file(authority()));
    return exit_ok;
  }
};

std::int64_t days_from_now(int days) {
  return config::system_clock().wall_ms() / 1000 + std::int64_t{days} * 24 * 3600;
}

/// A verb about a file of tokens.
class OfTokens : public Verb {
 public:
  using Verb::Verb;

 protected:
  void declare_holder(CLI::App& options, const char* what) { options.add_option("HOLDER", holder_, what)->required(); }
  void declare_file(CLI::App& options) {
    options.add_option("--file", file_, "the token file")->required()->type_name("FILE");
  }
  std::string file_, holder_;
};

class AddToken final : public OfTokens {
 public:
  AddToken()
      : OfTokens(
            {"add", "Make a token and print it: it is shown this once, and only its hash is kept",
             "iotcloud token add anna --role operator --certificate operator.pem --file tokens > anna.token\n"
             "  iotcloud token add master --role master --certificate master.pem --file gateway.tokens > lab1.token",
             std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    declare_holder(options, "whose: what the audit log calls them");
    options
        .add_option("--role", role_,
                    "viewer: reads; operator: also starts, stops and describes; admin: everything; master: a gateway "
                    "master at a gateway, with --certificate")
        ->required()
        ->check(CLI::IsMember({"viewer", "operator", "admin", "master"}))
        ->type_name("ROLE");
    options
        .add_option("--certificate", certificate_,
                    "the token counts only with this certificate: its file (NAME.pem), or its common name. For "
                    "daemons, and for people who show it from one machine: who catches it in a master's place then "
                    "has no use of it")
        ->type_name("CERTIFICATE");
    options.add_option("--days", days_, "after so many days it is worth nothing; without it the token has no end")
        ->check(CLI::Range(1, 3650))
        ->type_name("N");
    declare_file(options);
  }
  int run(Call& call) override {
    // The token is alone on its line, so that a script can read it.
    call.out << security::add_token(file_, holder_, security::parse_role(role_), subject(),
                                    days_ == 0 ? 0 : days_from_now(days_))
             << '\n';
    return exit_ok;
  }

 private:
  std::string subject() const {
    if (certificate_.ends_with(".pem")) return security::subject_in(certificate_);
    return certificate_.empty() || certificate_.find('=') != std::string::npos ? certificate_ : "CN=" + certificate_;
  }
  std::string role_;
  std::string certificate_;
  int days_ = 0;
};

class RenewToken final : public OfTokens {
 public:
  RenewToken()
      : OfTokens({"renew", "Let a token count for longer: the holder keeps it. Daemons notice within seconds",
                  "iotcloud token renew anna --days 365 --file tokens", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    declare_holder(options, "whose");
    options.add_option("--days", days_, "after so many days from now it is worth nothing")
        ->required()
        ->check(CLI::Range(1, 3650))
        ->type_name("N");
    declare_file(options);
  }
  int run(Call& call) override {
    const auto end = days_from_now(days_);
    if (!security::renew_token(file_, holder_, end))
      throw config::Error(fmt::format("{} has no token of {}", file_, holder_));
    call.out << fmt::format("the token of {} counts until {}\n", holder_, security::expiry_text(end));
    return exit_ok;
  }

 private:
  int days_ = 0;
};

class RemoveToken final : public OfTokens {
 public:
  RemoveToken()
      : OfTokens({"remove", "Take a token away; daemons notice within seconds, also on open connections",
                  "iotcloud token remove anna --file tokens", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    declare_holder(options, "whose");
    declare_file(options);
  }
  int run(Call&) override {
    if (!security::remove_token(file_, holder_))
      throw config::Error(fmt::format("{} has no token of {}", file_, holder_));
    return exit_ok;
  }
};

class ListTokens final : public OfTokens {
 public:
  ListTokens()
      : OfTokens({"list", "List whose tokens there are, with their roles and ends", "iotcloud token list --file tokens",
                  std::nullopt}) {}
  void declare(CLI::App& options) override { declare_file(options); }
  int run(Call& call) override {
    std::vector<std::vector<std::string>> rows;
    Json json = Json::array();
    for (const auto& entry : security::read_tokens(file_)) {
      const std::string end = security::expiry_text(entry.expires_s);
      rows.push_back({entry.name, to_string(entry.role), end, entry.certificate});
      json.push_back({{"name", entry.name},
                      {"role", to_string(entry.role)},
                      {"expires", end},
                      {"certificate", entry.certificate}});
    }
    print(call.out, call.format, {"NAME", "ROLE", "EXPIRES", "CERTIFICATE"}, rows, json);
    return exit_ok;
  }
};

class VerifyAudit final : public Verb {
 public:
  VerifyAudit()
      : Verb({"verify",
              "Check an audit log: whether lines were changed, removed, added or put in another order, or its end was "
              "cut off. Prints its head, NUMBER:HASH: kept elsewhere, it shows later whether somebody wrote the whole "
              "log anew. Exit status 1: something is wrong",
              "iotcloud audit verify audit.log.1 audit.log\n  iotcloud audit verify audit.log --head 120:9f86d081...",
              std::nullopt}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", files_, "the files of one log, the oldest first")->required()->type_name("FILE");
    options.add_option("--head", head_, "a head that an earlier verification printed")->type_name("NUMBER:HASH");
    options.add_option("--from", expected_.from, "older files were deleted on purpose: it begins with this line")
        ->type_name("NUMBER");
    options.add_flag("--rotated", rotated_, "the last file was rotated away, so FILE.head is about a newer one");
  }
  void check() override {
    if (head_.empty()) return;
    expected_.known = security::parse_audit_head(head_);
    if (!expected_.known) throw CLI::ValidationError("--head", "it has the form NUMBER:HASH, as printed by this verb");
  }
  int run(Call& call) override {
    expected_.has_head = !rotated_;
    const auto verdict = security::verify_audit(files_, expected_);
    std::vector<std::vector<std::string>> rows;
    Json json = Json::array();
    for (const auto& finding : verdict.findings) {
      rows.push_back({finding.file, finding.line == 0 ? "-" : std::to_string(finding.line), finding.text});
      json.push_back({{"file", finding.file}, {"line", finding.line}, {"finding", finding.text}});
    }
    const Json answer{{"first", verdict.first},
                      {"last", verdict.head.number},
                      {"head", to_string(verdict.head)},
                      {"unchained", verdict.unchained},
                      {"findings", json}};
    if (call.format != Format::table) {
      print(call.out, call.format, {}, {}, answer);
    } else {
      if (!rows.empty()) print(call.out, call.format, {"FILE", "LINE", "FINDING"}, rows, json);
      call.out << fmt::format("lines {} to {}, {}; head {}\n", verdict.first, verdict.head.number,
                              rows.empty() ? "nothing was changed" : "NOT as they were written",
                              to_string(verdict.head));
      if (verdict.unchained > 0)
        call.out << fmt::format("{} lines before them are of a version without chain\n", verdict.unchained);
    }
    return rows.empty() ? exit_ok : exit_failed;
  }

 private:
  std::vector<std::string> files_;
  std::string head_;
  bool rotated_ = false;
  security::AuditExpectation expected_;
};

}  // namespace

void add_security_verbs(Verbs& verbs) {
  auto& certs = verbs.group("certs", "Make certificates for a small installation; asks no master");
  certs.add<Certs>(true);
  certs.add<Certs>(false);
  certs.add<RenewCertificates>();
  certs.add<RevokeCertificates>();
  auto& tokens = verbs.group("token", "Keep a file of tokens, which a daemon reads; asks no master");
  tokens.add<AddToken>();
  tokens.add<RenewToken>();
  tokens.add<RemoveToken>();
  tokens.add<ListTokens>();
  auto& audit = verbs.group("audit", "Look at an audit log; asks no master");
  audit.add<VerifyAudit>();
}

}  // namespace iotcloud::master::cli
