// The way from nothing to a master that others may reach: `certs init`, `token add`, the daemon's file, the options.
#include <array>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/access.h>
#include <iotcloud/master/master_service.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/registry_password.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/security/tls.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/master/process.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::master::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

/// Keeps what clients say to it, and closes their connections. Thread safe.
class RecordingListener {
 public:
  RecordingListener() : thread_([this] { record(); }) {}
  ~RecordingListener() { shutdown(listener_.socket(), SHUT_RDWR); }
  RecordingListener(const RecordingListener&) = delete;
  RecordingListener& operator=(const RecordingListener&) = delete;

  std::string at(const std::string& host) const { return host + ":" + std::to_string(listener_.port()); }
  std::string heard() {
    const std::lock_guard lock(mutex_);
    return heard_;
  }

 private:
  void record() {
    for (int client = listener_.accept(); client >= 0; client = listener_.accept()) {
      std::array<char, 4096> bytes{};
      const auto size = recv(client, bytes.data(), bytes.size(), 0);
      {
        const std::lock_guard lock(mutex_);
        heard_.append(bytes.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
      }
      close(client);
    }
  }

  tests::LoopbackListener listener_;
  std::mutex mutex_;
  std::string heard_;    ///< guarded by mutex_
  std::jthread thread_;  ///< last: it uses the others
};

/// A master that keeps the token that it was shown, takes everybody in, and names another one as the leader, or leads
/// if it names none. Thread safe.
class PlayedMaster final : public wire::TMasterAPIServiceNull {
 public:
  /// \param leader empty: it leads itself. \param standby_for so many orders it names that leader, then it leads
  explicit PlayedMaster(std::string leader = "", int standby_for = std::numeric_limits<int>::max())
      : leader_(std::move(leader)), standby_for_(standby_for) {}
  void authenticate(discovery::wire::TResponse& answer, const std::string& token) override {
    const std::lock_guard lock(mutex_);
    token_ = token;
    answer.__set_state(discovery::wire::TResponseState::SUCCESS);
  }
  void drain(wire::TOrderResponse& answer, const wire::TGatewaySelection&) override {
    if (leader_.empty() || standby_for_-- <= 0) {
      answer.response.__set_statusMessage("done");
      return;
    }
    answer.__set_refusal(wire::TRefusal::NOT_LEADING);
    answer.__set_leader(leader_);
  }
  std::string token() {
    const std::lock_guard lock(mutex_);
    return token_;
  }

 private:
  const std::string leader_;
  std::atomic<int> standby_for_;
  std::mutex mutex_;
  std::string token_;  ///< guarded by mutex_
};

std::unique_ptr<rpc::ThriftServer> serve_played(const std::shared_ptr<PlayedMaster>& master,
                                                const security::TlsFiles& tls = {}) {
  rpc::ThriftServerOptions options;
  options.tls = tls;
  return std::make_unique<rpc::ThriftServer>(
      options, [p = std::make_shared<wire::TMasterAPIServiceProcessor>(master)](const auto&) { return p; });
}

class CliSecurity : public testing::Test {
 protected:
  static Finished run(std::vector<std::string> words) {
    words.insert(words.begin(), IOTCLOUD_CLI);
    return run_program(words);
  }
  /// The token without its line's end.
  std::string add_token(const std::string& name, const std::string& role) const {
    const auto done = run({"token", "add", name, "--role", role, "--file", folder_ / "tokens"});
    EXPECT_EQ(done.status, 0) << done.err;
    return done.out.substr(0, done.out.find('\n'));
  }
  std::string error_of(const std::string& api) const {
    const std::string file = folder_ / "master.yaml";
    std::ofstream(file) << "registry: \"embedded://a\"\napi: " << api << "\n";
    try {
      load_master_config(file);
    } catch (const config::ConfigError& e) {
      return e.what();
    }
    return "";
  }
  std::string tls() const {
    const std::string certs = folder_ / "certs";
    return "tls: {ca: " + certs + "/ca.pem, certificate: " + certs + "/lab1.pem, key: " + certs + "/lab1.key}";
  }

  const tests::TemporaryFolder folder_;
};

TEST_F(CliSecurity, CertsInitMakesFilesSaysWhatIsNextAndOverwritesNothing) {
  const std::string certs = folder_ / "certs";
  const auto done = run({"certs", "init", certs, "--host", "lab1", "lab2"});
  ASSERT_EQ(done.status, 0) << done.err;
  for (const char* name : {"ca.pem", "ca.key", "lab1.pem", "lab1.key", "lab2.pem", "operator.pem", "operator.key"})
    EXPECT_TRUE(std::filesystem::exists(certs + "/" + name)) << name;
  EXPECT_THAT(done.out, AllOf(HasSubstr("Next"), HasSubstr("tls: {ca: "), HasSubstr("token add"), HasSubstr("--ca"),
                              Not(HasSubstr("PRIVATE KEY"))));
  const auto again = run({"certs", "init", certs, "--host", "lab3"});
  EXPECT_EQ(again.status, 1);
  EXPECT_THAT(again.err, AllOf(HasSubstr("not overwritten"), HasSubstr("certs add")));
  EXPECT_FALSE(std::filesystem::exists(certs + "/lab3.pem"));
  EXPECT_EQ(run({"certs", "add", certs, "--host", "lab3", "--caller", "anna"}).status, 0);
  EXPECT_TRUE(std::filesystem::exists(certs + "/lab3.pem") && std::filesystem::exists(certs + "/anna.key"));
}

TEST_F(CliSecurity, EachDaemonOfAMachineMayHaveACertificateOfItsOwn) {
  const std::string certs = folder_ / "certs";
  ASSERT_EQ(run({"certs", "init", certs, "--host", "lab1"}).status, 0);
  const auto add = [&](std::vector<std::string> words) {
    words.insert(words.begin(), {"certs", "add", certs});
    return run(words);
  };
  EXPECT_EQ(add({"--host", "lab2,192.0.2.7", "--daemon", "lab2-gateway", "--gateway", "g1"}).status, 0);
  const auto master = add({"--host", "lab2", "--daemon", "lab2-master"});
  EXPECT_EQ(master.status, 0);
  EXPECT_THAT(master.out, AllOf(HasSubstr("lab2-master.key  for lab2-master"), HasSubstr("advertise: \"lab2:PORT\"")));
  EXPECT_FALSE(std::filesystem::exists(certs + "/lab2.pem"));
  EXPECT_EQ(security::subject_in(certs + "/lab2-gateway.pem"), "CN=lab2-gateway");
  EXPECT_EQ(add({"--daemon", "lab2-worker"}).status, 2) << "no machine";
  EXPECT_EQ(run({"certs", "renew", certs, "lab2-gateway", "--new-key"}).status, 0);
}

TEST_F(CliSecurity, ATokenIsPrintedOnceAndListedWithoutIt) {
  const auto token = add_token("anna", "operator");
  EXPECT_THAT(token, HasSubstr("anna."));
  const auto listed = run({"token", "list", "--file", folder_ / "tokens", "-o", "json"});
  const auto json = nlohmann::json::parse(listed.out);
  ASSERT_EQ(json.size(), 1u);
  EXPECT_EQ(json[0]["name"], "anna");
  EXPECT_EQ(json[0]["role"], "operator");
  EXPECT_THAT(listed.out, Not(HasSubstr(token.substr(5))));
  EXPECT_EQ(run({"token", "add", "anna", "--role", "viewer", "--file", folder_ / "tokens"}).status, 1);
  EXPECT_EQ(run({"token", "remove", "anna", "--file", folder_ / "tokens"}).status, 0);
  EXPECT_EQ(run({"token", "remove", "anna", "--file", folder_ / "tokens"}).status, 1);
}

TEST_F(CliSecurity, ATokenMayHaveAnEndThatIsPutOff) {
  const std::string file = folder_ / "tokens";
  ASSERT_EQ(run({"token", "add", "anna", "--role", "viewer", "--days", "1", "--file", file}).status, 0);
  const auto end = [&] { return security::read_tokens(file).at(0).expires_s; };
  const auto first = end();
  EXPECT_GT(first, 0);
  const auto renewed = run({"token", "renew", "anna", "--days", "3", "--file", file});
  EXPECT_EQ(renewed.status, 0) << renewed.err;
  EXPECT_GE(end() - first, 2 * 24 * 3600);
  EXPECT_THAT(renewed.out, HasSubstr(security::expiry_text(end())));
  EXPECT_THAT(run({"token", "list", "--file", file}).out, HasSubstr(security::expiry_text(end())));
  EXPECT_EQ(run({"token", "renew", "bob", "--days", "3", "--file", file}).status, 1);
  EXPECT_EQ(run({"token", "renew", "anna", "--days", "0", "--file", file}).status, 2);
}

TEST_F(CliSecurity, ADaemonsTokenNamesItsCertificate) {
  const std::string certs = folder_ / "certs";
  ASSERT_EQ(run({"certs", "init", certs, "--host", "lab1", "--gateway", "g1,g2"}).status, 0);
  const std::string file = folder_ / "gateway.tokens";
  const auto add = [&](const std::string& holder, const std::string& certificate) {
    return run({"token", "add", holder, "--role", "master", "--certificate", certificate, "--file", file}).status;
  };
  EXPECT_EQ(add("by-file", certs + "/lab1.pem"), 0);
  EXPECT_EQ(add("by-name", "lab2"), 0);
  EXPECT_EQ(add("by-subject", "CN=lab3,O=lab"), 0);
  EXPECT_EQ(add("nowhere", certs + "/lab9.pem"), 1);
  EXPECT_EQ(run({"token", "add", "bare", "--role", "master", "--file", file}).status, 1);
  const auto list = run({"token", "list", "--file", file});
  EXPECT_THAT(list.out, AllOf(HasSubstr("CN=lab1"), HasSubstr("CN=lab2"), HasSubstr("CN=lab3,O=lab")));
  EXPECT_EQ(run({"certs", "add", certs, "--host", "a,b", "--gateway", "g3"}).status, 1);
}

TEST_F(CliSecurity, AUserOfTheRegistryIsAddedAndItsPasswordPrintedOnce) {
  EXPECT_EQ(security::registry_digest("super", "test"), "D/InIHSb7yEEbrWz8b9l71RjZJU=");
  const std::string file = folder_ / "registry.users";
  const auto add = [&](const std::string& name, const std::string& role) {
    return run({"registry", "user", name, "--role", role, "--file", file});
  };
  EXPECT_EQ(add("masters", "master").status, 0);
  const auto one = add("g1", "gateway");
  ASSERT_EQ(one.status, 0);
  const auto users = discovery::read_registry_users(file);
  ASSERT_EQ(users.size(), 2U);
  EXPECT_EQ(users[1].name, "g1");
  EXPECT_EQ(users[1].digest, security::registry_digest("g1", one.out.substr(0, one.out.size() - 1)));
  EXPECT_EQ(add("g1", "worker").status, 1);
  EXPECT_EQ(add("a:b", "worker").status, 1);
  EXPECT_EQ(add("g2", "guest").status, 2);
  EXPECT_EQ(discovery::read_registry_users(file).size(), 2U);
}

TEST_F(CliSecurity, AnAddressThatOthersReachTakesTlsAndTokens) {
  ASSERT_EQ(run({"certs", "init", folder_ / "certs", "--host", "lab1"}).status, 0);
  add_token("anna", "admin");
  const std::string tokens = "tokens: " + (folder_ / "tokens");
  const std::string wide = "{host: 192.0.2.7, ";
  EXPECT_THAT(error_of(wide + "port: 1}"), AllOf(HasSubstr("api.host"), HasSubstr("TLS and tokens"),
                                                 HasSubstr("certs init"), HasSubstr("token add")));
  EXPECT_THAT(error_of(wide + tls() + "}"), HasSubstr("without tokens"));
  EXPECT_THAT(error_of(wide + tokens + "}"), HasSubstr("without TLS"));
  EXPECT_THAT(error_of(wide + tokens + ", " + tls() + "}"), IsEmpty());
  EXPECT_THAT(error_of("{host: 0.0.0.0, " + tokens + ", " + tls() + "}"), HasSubstr("advertise"));
  EXPECT_THAT(error_of("{host: 0.0.0.0, advertise: \"lab1:12904\", " + tokens + ", " + tls() + "}"), IsEmpty());
}

TEST_F(CliSecurity, AMasterWithTlsAndTokensAnswersThoseWhoHaveBoth) {
  const std::string certs = folder_ / "certs";
  ASSERT_EQ(run({"certs", "init", certs, "--host", "lab1"}).status, 0);
  const std::string token = folder_ / "anna.token";
  std::ofstream(token) << add_token("anna", "admin") << "\n";
  MasterDaemonConfig config;
  config.id = "m1";
  config.registry.url = "embedded://cli-security-" + std::to_string(getpid());
  config.sensors_root = "/iot/sensors";
  config.api = {"0.0.0.0",
                tests::free_port(),
                {certs + "/ca.pem", certs + "/lab1.pem", certs + "/lab1.key"},
                folder_ / "tokens",
                "localhost:1"};
  config.audit.file = folder_ / "audit.log";
  auto service = make_master_service(config);
  service->start();
  const std::string address = "localhost:" + std::to_string(config.api.port);
  const auto ask = [&](const std::vector<std::string>& identity) {
    std::vector<std::string> words{"--master", address};
    words.insert(words.end(), identity.begin(), identity.end());
    words.emplace_back("gateways");
    return run(words);
  };
  const std::vector<std::string> certificate{"--ca",  certs + "/ca.pem",      "--certificate", certs + "/operator.pem",
                                             "--key", certs + "/operator.key"};
  auto both = certificate;
  both.insert(both.end(), {"--token-file", token});
  const auto good = ask(both);
  EXPECT_EQ(good.status, 0) << good.err;
  const auto without_token = ask(certificate);
  EXPECT_EQ(without_token.status, 1);
  EXPECT_THAT(without_token.err, HasSubstr("token"));
  const auto without_tls = ask({"--token-file", token});
  EXPECT_EQ(without_tls.status, 3);
  EXPECT_THAT(without_tls.err, HasSubstr("does it ask for TLS?"));

  // SIGHUP: who was taken out of the file does not get in any more.
  ASSERT_EQ(run({"token", "remove", "anna", "--file", folder_ / "tokens"}).status, 0);
  service->reload();
  EXPECT_EQ(ask(both).status, 1);
  service->stop(std::chrono::seconds(5));
}

TEST_F(CliSecurity, ATokenThatAFalseMasterHasCaughtIsOfNoUseWithoutThePersonsCertificate) {
  const security::test::Certificates certificates;
  const auto& authority = certificates.authority();
  authority.certify_daemon("lab1-gateway", {"lab1", "localhost"}, {.gateways = {"gateway-1"}});
  MasterDaemonConfig config;
  config.registry.url = "embedded://cli-caught-" + std::to_string(getpid());
  config.sensors_root = "/iot/sensors";
  config.api = {"0.0.0.0", tests::free_port(), certificates.of("lab1"), folder_ / "tokens", "localhost:1"};
  const auto add = [&](const std::string& name, std::vector<std::string> more) {
    std::vector<std::string> words{"token", "add", name, "--role", "admin", "--file", folder_ / "tokens"};
    words.insert(words.end(), more.begin(), more.end());
    const auto done = run(words);
    EXPECT_EQ(done.status, 0) << done.err;
    return done.out.substr(0, done.out.find('\n'));
  };
  const auto bound = add("anna", {"--certificate", authority.certificate("operator")});
  const auto unbound = add("otto", {});
  auto service = make_master_service(config);
  service->start();
  // On the master's machine, in its place, with what the thief of its gateway has.
  const auto caught = std::make_shared<PlayedMaster>();
  const auto false_master = serve_played(caught, certificates.of("lab1-gateway"));
  const auto ask = [&](int port, const std::string& certificate, const std::string& token) {
    const auto own = certificates.of(certificate);
    std::ofstream(folder_ / "shown.token") << token << "\n";
    return run({"--master", "localhost:" + std::to_string(port), "--ca", own.ca, "--certificate", own.certificate,
                "--key", own.key, "--token-file", folder_ / "shown.token", "gateways"});
  };
  for (const auto& token : {bound, unbound}) {
    ask(false_master->port(), "operator", token);
    EXPECT_EQ(caught->token(), token) << "the attack";
    const auto person = ask(config.api.port, "operator", token);
    EXPECT_EQ(person.status, 0) << person.err;
  }
  EXPECT_EQ(ask(config.api.port, "lab1-gateway", unbound).status, 0)
      << "what a token without a certificate is good for";
  const auto thief = ask(config.api.port, "lab1-gateway", bound);
  EXPECT_EQ(thief.status, 1);
  EXPECT_THAT(thief.err, HasSubstr("token"));
  service->stop(std::chrono::seconds(5));
}

TEST_F(CliSecurity, NoTokenIsSentInClearToAnotherMachine) {
  RecordingListener stranger;
  const std::string token = folder_ / "anna.token";
  std::ofstream(token) << "anna.secret\n";
  run({"--master", stranger.at("127.0.0.1"), "--token-file", token, "gateways"});
  ASSERT_THAT(stranger.heard(), HasSubstr("anna.secret")) << "on this machine, and so it would be heard elsewhere";
  RecordingListener far;
  const auto refused = run({"--master", far.at("0.0.0.0"), "--token-file", token, "gateways"});
  EXPECT_EQ(refused.status, 2);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("is not on this machine"), HasSubstr("--ca, --certificate and --key"),
                                 HasSubstr("a tunnel on 127.0.0.1")));
  EXPECT_EQ(far.heard(), "");
  // A standby of this machine that names a leader elsewhere.
  const auto standby = serve_played(std::make_shared<PlayedMaster>(far.at("0.0.0.0")));
  const auto sent_on =
      run({"--master", "127.0.0.1:" + std::to_string(standby->port()), "--token-file", token, "drain", "lab1"});
  EXPECT_EQ(sent_on.status, 1);
  EXPECT_THAT(sent_on.err, HasSubstr("is not on this machine"));
  EXPECT_EQ(far.heard(), "");
  // It leads at the near end of a tunnel.
  const auto leader = serve_played(std::make_shared<PlayedMaster>());
  const auto at = [](const auto& server) { return "127.0.0.1:" + std::to_string(server->port()); };
  const auto tunnels = at(standby) + ",127.0.0.1:1," + at(leader);
  const auto taken = run({"--master", tunnels, "--token-file", token, "drain", "lab1"});
  EXPECT_EQ(taken.status, 0) << taken.err;
  EXPECT_EQ(far.heard(), "");
  const auto other = serve_played(std::make_shared<PlayedMaster>(far.at("0.0.0.0")));
  const auto none = run({"--master", at(standby) + "," + at(other), "--token-file", token, "drain", "lab1"});
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("is not on this machine"));
  EXPECT_EQ(far.heard(), "");
  // The leader has died: one tunnel leads nowhere, and the standby at the other one leads soon.
  const auto next = serve_played(std::make_shared<PlayedMaster>(far.at("0.0.0.0"), 2));
  const auto later = run({"--master", "127.0.0.1:1," + at(next), "--token-file", token, "drain", "lab1"});
  EXPECT_EQ(later.status, 0) << later.err;
  EXPECT_EQ(far.heard(), "");
  // Without a token there is nothing to hide.
  run({"--master", far.at("0.0.0.0"), "gateways"});
  EXPECT_THAT(far.heard(), HasSubstr("getStatus"));
}

TEST_F(CliSecurity, AMasterWhoseCertificateIsRevokedDoesNotSeeTheToken) {
  const security::test::Certificates certificates;
  const auto& authority = certificates.authority();
  const auto master = std::make_shared<PlayedMaster>();
  const auto server = serve_played(master, certificates.of("lab1"));
  const auto own = certificates.of("operator");
  const std::string token = folder_ / "anna.token";
  const auto ask = [&](const std::string& shown) {
    std::ofstream(token) << shown << "\n";
    return run({"--master", "localhost:" + std::to_string(server->port()), "--ca", own.ca, "--certificate",
                own.certificate, "--key", own.key, "--revoked", security::revocations_file(authority), "--token-file",
                token, "gateways"});
  };
  security::make_revocations(authority);
  ask("first");
  EXPECT_EQ(master->token(), "first");
  security::revoke_certificate(authority, "lab1");
  const auto refused = ask("second");
  EXPECT_EQ(refused.status, 3);
  EXPECT_THAT(refused.err, HasSubstr("certificate revoked"));
  EXPECT_EQ(master->token(), "first");

  const auto alone = run({"--revoked", security::revocations_file(authority), "gateways"});
  EXPECT_EQ(alone.status, 2) << "a list without TLS would be of no use";
  EXPECT_THAT(alone.err, HasSubstr("give all three"));
}

TEST_F(CliSecurity, AuditVerifyNamesTheLineThatWasChanged) {
  const std::string file = folder_ / "audit.log";
  {
    security::AuditLog log(file);
    for (const char* who : {"anna", "otto", "vera"}) {
      security::AuditEntry entry;
      entry.who = who;
      log.write(entry);
    }
  }
  const auto good = run({"audit", "verify", file});
  EXPECT_EQ(good.status, 0) << good.out;
  EXPECT_THAT(good.out, HasSubstr("lines 1 to 3, nothing was changed; head 3:"));
  std::ifstream in(file);
  std::string text((std::istreambuf_iterator<char>(in)), {});
  text.replace(text.find("otto"), 4, "vera");
  std::ofstream(file) << text;
  const auto bad = run({"audit", "verify", file, "-o", "json"});
  EXPECT_EQ(bad.status, 1);
  EXPECT_THAT(bad.out, HasSubstr("line 2 was changed after it was written"));
  EXPECT_EQ(run({"audit", "verify", file, "--head", "three"}).status, 2);
}

TEST_F(CliSecurity, CertificatesAreRenewedAndRevoked) {
  const std::string certs = folder_ / "certs";
  ASSERT_EQ(run({"certs", "init", certs, "--host", "lab1"}).status, 0);
  ASSERT_EQ(run({"certs", "renew", certs, "lab1", "--days", "10"}).status, 0);
  EXPECT_NEAR(security::days_left(certs + "/lab1.pem"), 10, 0.1);
  const security::TlsFiles files{certs + "/ca.pem", certs + "/lab1.pem", certs + "/lab1.key", certs + "/revoked.pem"};
  EXPECT_NO_THROW(security::TlsContext(files, security::TlsContext::Side::server)) << "the key still fits";
  const auto revoked = run({"certs", "revoke", certs, "operator"});
  EXPECT_EQ(revoked.status, 0) << revoked.err;
  EXPECT_EQ(run({"certs", "revoke", certs, "operator"}).status, 0) << "again, it changes nothing";
  EXPECT_EQ(run({"certs", "renew", certs, "nobody"}).status, 1);
}

TEST_F(CliSecurity, TheDaemonRefusesToStartWithoutThem) {
  MasterDaemonConfig config;
  config.registry.url = "embedded://cli-security-" + std::to_string(getpid());
  config.sensors_root = "/iot/sensors";
  config.api.host = "0.0.0.0";
  auto service = make_master_service(config);
  EXPECT_THROW(service->start(), config::Error);
}

}  // namespace
}  // namespace iotcloud::master::test
