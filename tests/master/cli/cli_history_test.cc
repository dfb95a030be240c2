// describe, history and logs: what the command line has from a gateway, by way of the master.
#include <fstream>
#include <mutex>

#include <gmock/gmock.h>
#include <thrift/TProcessor.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// The Thrift service of a gateway that remembers what the test says. Thread safe.
class PlayedSite final : public gateway::wire::TSensorSiteServiceNull {
 public:
  void authenticate(discovery::wire::TResponse& answer, const std::string& token) override {
    const std::lock_guard lock(mutex_);
    token_ = token;
    answer.__set_state(discovery::wire::TResponseState::SUCCESS);
  }
  std::string token() {
    const std::lock_guard lock(mutex_);
    return token_;
  }
  void ping(gateway::wire::TPing& answer) override {
    const std::lock_guard lock(mutex_);
    answer.__set_gateway(gateway_);
  }
  void getChanges(std::vector<gateway::wire::TStateChange>& answer, const std::string& instance) override {
    const std::lock_guard lock(mutex_);
    for (const auto& change : changes_) {
      if (instance.empty() || change.instance == instance) answer.push_back(change);
    }
  }
  void readLog(gateway::wire::TLogPart& part, const std::string& instance, const std::string& position,
               std::int32_t) override {
    const std::lock_guard lock(mutex_);
    if (log_.empty() || position == "2") {
      gateway::wire::TSiteError error;
      error.__set_reason(log_.empty() ? "there is no log yet" : "it is gone");
      throw error;
    }
    const std::string word = position.empty() ? ": active\n" : ": went on\n";
    part.__set_text(log_ + "2026 info  gateway.host: " + instance + word);
    part.__set_position(position.empty() ? "1" : "2");
  }
  void remember(const std::string& instance, const std::string& state, std::int64_t time_ms,
                const std::string& reason = "") {
    const std::lock_guard lock(mutex_);
    auto& change = changes_.emplace_back();
    change.__set_instance(instance);
    change.__set_driver("turtle");
    change.__set_state(state);
    change.__set_timeMs(time_ms);
    change.__set_reason(reason);
  }

  void be(const std::string& gateway) {
    const std::lock_guard lock(mutex_);
    gateway_ = gateway;
  }
  void forget_log() {
    const std::lock_guard lock(mutex_);
    log_.clear();
  }

 private:
  std::mutex mutex_;
  std::string gateway_ = "lab1";                                  ///< guarded by mutex_
  std::string token_;                                             ///< guarded by mutex_
  std::vector<gateway::wire::TStateChange> changes_;              ///< guarded by mutex_
  std::string log_ = "2026 info  gateway.host: other: active\n";  ///< guarded by mutex_
};

class CliHistory : public Cli {
 protected:
  CliHistory() {
    service_.emplace(
        rpc::ThriftServerOptions{},
        [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site_)](const auto&) { return p; });
    serve("lab1", service_->port());
  }
  /// From now on the gateway's record says that its service is there.
  void serve(const std::string& gateway, int port, bool tls = false) const {
    const discovery::Paths paths;
    auto registry = open_registry(url);
    auto record = discovery::decode_gateway(registry->get(paths.gateway(discovery::GatewayId(gateway)))->data, gateway);
    record.host = "127.0.0.1";
    record.port = port;
    record.tls = tls;
    discovery::put(*registry, paths.gateway(discovery::GatewayId(gateway)), encode(record));
  }

  FakeGateway lab1_{url, "lab1"};
  const std::shared_ptr<PlayedSite> site_ = std::make_shared<PlayedSite>();
  std::optional<rpc::ThriftServer> service_;
};

TEST_F(CliHistory, AnOrderSaysWhatItWaitsFor) {
  lab1_.behave([](const discovery::OrderRecord&) -> std::optional<FakeGateway::Report> {
    return std::pair(discovery::DriverState::starting, "its driver host crashed; it is started again in 500 ms");
  });
  const auto started = run({"deploy", "turtle.so", "--gateway", "lab1", "--name", "slow", "--wait", "5", "-o", "json"});
  EXPECT_EQ(started.status, 1);
  EXPECT_THAT(started.err, HasSubstr("iotcloud: waits: "));
  EXPECT_THAT(started.err, HasSubstr(" on lab1 is starting: its driver host crashed; it is started again in 500 ms"));
  EXPECT_EQ(started.err.find("waits"), started.err.rfind("waits")) << "once";
  lab1_.behave(FakeGateway::say_nothing());
  const auto slow = lab1_.orders().at(0).instance.str();
  for (const bool starts_again : {false, true}) {
    lab1_.report(slow, discovery::DriverState::failed, "no device", starts_again);
    const auto stopped = run({"stop", slow, "--wait", "5"});
    EXPECT_EQ(stopped.err.find("is failed: no device") != std::string::npos, starts_again) << stopped.err;
  }
  const auto silent = run({"deploy", "turtle.so", "--gateway", "lab1", "--name", "silent", "--wait", "5"});
  EXPECT_THAT(silent.err, HasSubstr("iotcloud: waits: no gateway has reported on the order yet"));
}

TEST_F(CliHistory, EventsShowTheLatestChangesByName) {
  const auto named = run({"deploy", "turtle.so", "-g", "lab1", "--name", "station-29"});
  ASSERT_EQ(named.status, 0) << named.err;
  const std::string id = lab1_.orders().at(0).instance;
  site_->remember(id, "starting", 1'000'000'000'000, "its driver host crashed");
  site_->remember("another", "active", 1'000'000'000'001);
  const auto done = run({"events"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out,
              AllOf(HasSubstr("2001-09-09T01:46:40.000Z  driver    station-29/1 (turtle) on lab1  starting: its "
                              "driver host crashed\n"),
                    HasSubstr("another (turtle) on lab1  active\n")));
  EXPECT_THAT(run({"events", "-n", "1"}).out, Not(HasSubstr("station-29")));
  // Names stand wherever ids do.
  for (const char* verb : {"describe", "history", "logs"}) {
    const auto by_name = run({verb, "station-29"});
    EXPECT_EQ(by_name.status, 0) << verb << ": " << by_name.err;
    EXPECT_THAT(by_name.out, HasSubstr(id)) << verb;
  }
}

TEST_F(CliHistory, FollowedEventsShowChangesOfDriversAndGatewaysOnce) {
  RunningProgram events({IOTCLOUD_CLI, "events", "-f", "-o", "json"}, {{"IOTCLOUD_MASTER", address()}});
  site_->remember("another", "active", 1'000'000'000'001);
  EXPECT_TRUE(eventually([&] { return events.out().find("\"another") != std::string::npos; })) << events.out();
  EXPECT_EQ(run({"drain", "lab1"}).status, 0);
  EXPECT_TRUE(eventually([&] { return events.out().find("\"state\":\"ready, draining\"") != std::string::npos; }))
      << events.out();
  const auto out = events.out();
  EXPECT_EQ(out.find("another"), out.rfind("another"));
}

TEST_F(CliHistory, AWatchedListIsShownAgain) {
  RunningProgram watched({IOTCLOUD_CLI, "gateways", "--watch", "0.1"}, {{"IOTCLOUD_MASTER", address()}});
  EXPECT_TRUE(eventually([&] {
    const auto out = watched.out();
    return out.find("GATEWAY") != out.rfind("GATEWAY");
  }));
}

TEST_F(CliHistory, DescribeShowsTheRecordTheChannelsAndEveryChangeWithTimeAndReason) {
  const auto id = deploy("lab1");
  site_->remember(id, "starting", 1'000'000'000'000, "its driver host crashed");
  site_->remember("another", "active", 1'000'000'000'001);
  const auto done = run({"describe", id.substr(0, 8)});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out, AllOf(HasSubstr(id), HasSubstr("lab1"), HasSubstr("active"), HasSubstr("CHANNEL"),
                              HasSubstr("amqp://robot:***@127.0.0.1:5672/"), Not(HasSubstr("secret")),
                              HasSubstr("2001-09-09T01:46:40.000Z"), HasSubstr("its driver host crashed")));
  const auto json = run_json({"describe", id});
  EXPECT_EQ(json["instance"], id);
  ASSERT_EQ(json["history"].size(), 1u);
  EXPECT_EQ(json["history"][0]["state"], "starting");
  EXPECT_THAT(json.dump(), AllOf(HasSubstr("amqp://robot:***@"), Not(HasSubstr("secret"))));
}

TEST_F(CliHistory, AnInstanceMayBeNamedInPlaceOfItsId) {
  DeployRequest request;
  request.plugin = "turtle.so";
  request.name = "meter";
  request.count = 2;
  request.gateways = {"lab1"_gateway};
  const auto deployed = (*master)->deploy(request);
  ASSERT_TRUE(deployed.all_done()) << deployed.summary();
  const auto json = run_json({"describe", "meter/2"});
  EXPECT_EQ(json["index"], 2);
  const std::string second = json["instance"];
  site_->remember(second, "active", 1000);
  site_->remember("another", "active", 2000);
  EXPECT_EQ(run_json({"history", "meter/2"}).size(), 1U);
  EXPECT_EQ(run_json({"drivers", "meter"}).size(), 2U);
  EXPECT_EQ(run_json({"drivers", "meter/1"}).size(), 1U);
  const auto logs = run({"logs", "meter/2"});
  EXPECT_THAT(logs.out, HasSubstr(second)) << logs.err;

  const auto both = run({"stop", "meter"});
  EXPECT_EQ(both.status, 2);
  EXPECT_THAT(both.err,
              AllOf(HasSubstr("\"meter\" is the name of 2 instances; give an id, or say --name for all of them"),
                    HasSubstr("meter/1 on lab1")));
  EXPECT_EQ(run({"stop", "meter/1"}).status, 0);
  EXPECT_EQ(run_json({"drivers", "--state", "inactive"}).at(0)["index"], 1);
}

TEST_F(CliHistory, HistoryHasThoseThatAreGoneAndIsInTheOrderOfTime) {
  site_->remember("gone", "active", 2000);
  site_->remember("gone", "undeployed", 3000, "as ordered");
  site_->remember("early", "active", 1000);
  const auto json = run_json({"history"});
  ASSERT_EQ(json.size(), 3u);
  EXPECT_EQ(json[0]["instance"], "early");
  EXPECT_EQ(json[2]["state"], "undeployed");
  EXPECT_EQ(json[2]["gateway"], "lab1");
  EXPECT_EQ(run_json({"history", "go"}).size(), 2u) << "how an id begins is enough";
  EXPECT_EQ(run_json({"history", "gone", "early", "--gateway", "lab1"}).size(), 3u);
}

TEST_F(CliHistory, OfManyChangesTheLatestAreShown) {
  for (int time_ms = 1; time_ms <= 120; ++time_ms) site_->remember("busy", "active", time_ms);
  EXPECT_EQ(run_json({"history"}).size(), 100u);
  const auto last = run_json({"history", "-n", "2"});
  ASSERT_EQ(last.size(), 2u);
  EXPECT_EQ(last[0]["time_ms"], 119);
  EXPECT_EQ(last[1]["time_ms"], 120);
}

TEST_F(CliHistory, AGatewayOfTheOriginalSystemIsNamedAsOne) {
  const FakeGateway old(url, "lab2");
  const rpc::ThriftServer knows_no_history(
      rpc::ThriftServerOptions{}, [p = std::make_shared<wire::TMasterAPIServiceProcessor>(
                                       std::make_shared<wire::TMasterAPIServiceNull>())](const auto&) { return p; });
  serve("lab2", knows_no_history.port());
  const auto done = run({"history", "--gateway", "lab2"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("lab2 is of the original system"));
}

TEST_F(CliHistory, WhatNobodyRemembersIsSaid) {
  site_->remember("gone", "active", 2000);
  auto done = run({"history", "never"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, AllOf(HasSubstr("\"never\""), HasSubstr("since they started")));
  done = run({"history", "--gateway", "nowhere"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("no gateway \"nowhere\""));
}

TEST_F(CliHistory, AnotherGatewayAtTheSameAddressIsNotTakenForIt) {
  const auto id = deploy("lab1");
  site_->remember(id, "active", 1000);
  site_->be("elsewhere");
  const auto done = run({"history"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, Not(HasSubstr(id)));
  EXPECT_THAT(done.err,
              AllOf(HasSubstr("the history of lab1 is missing"), HasSubstr("another gateway"), HasSubstr("elsewhere")));
  EXPECT_EQ(run({"logs", id}).status, 1);
}

TEST_F(CliHistory, AGatewayThatCannotBeAskedIsNamedAndTheOthersAnswer) {
  const FakeGateway silent(url, "lab2");
  serve("lab2", 0);
  site_->remember("a", "active", 1000);
  const auto done = run({"history"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, HasSubstr("active"));
  EXPECT_THAT(done.err, AllOf(HasSubstr("lab2"), HasSubstr("no Thrift service")));
}

TEST_F(CliHistory, LogsAreThoseOfTheInstanceOrOfItsWholeHost) {
  const auto id = deploy("lab1");
  const auto own = run({"logs", id});
  EXPECT_EQ(own.status, 0) << own.err;
  EXPECT_THAT(own.out, AllOf(HasSubstr(id + ": active"), Not(HasSubstr("other: active"))));
  const auto whole = run({"logs", id, "--whole-host"});
  EXPECT_THAT(whole.out, AllOf(HasSubstr(id + ": active"), HasSubstr("other: active")));
  EXPECT_THAT(run({"logs", id, "--whole-host", "--lines", "1"}).out, Not(HasSubstr("other: active")));
}

/// SECURITY.md: the thief of lab2 makes a record with the id of an instance on lab1.
TEST_F(CliHistory, LogsOfAnInstanceMayBeThoseOfAThiefWhoMadeARecordWithItsId) {
  const auto id = deploy("lab1");
  site_->forget_log();
  EXPECT_THAT(run({"logs", id}).err, HasSubstr("there is no log yet")) << "the instance's own gateway is asked";
  const FakeGateway stolen(url, "lab2");
  const auto thief = std::make_shared<PlayedSite>();
  thief->be("lab2");
  const rpc::ThriftServer service(
      rpc::ThriftServerOptions{},
      [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(thief)](const auto&) { return p; });
  serve("lab2", service.port());
  discovery::DriverRecord forged;
  forged.name = "aaa"_driver;
  forged.instance = discovery::InstanceId(id);
  forged.gateway = "lab2"_gateway;
  forged.state = discovery::DriverState::active;
  const discovery::Paths paths;
  discovery::put(*open_registry(url), paths.instance(forged.name, forged.instance), encode(forged));
  EXPECT_TRUE(eventually([&] {
    return run({"logs", id}).out.find(id + ": active") != std::string::npos;
  })) << "the thief's words";
}

TEST_F(CliHistory, FollowingGoesOnWhereItWasUntilTheGatewayTellsNoMore) {
  const auto id = deploy("lab1");
  const auto done = run({"logs", id, "--follow"});
  EXPECT_THAT(done.out, AllOf(HasSubstr(id + ": active"), HasSubstr(id + ": went on"), Not(HasSubstr("other"))));
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("it is gone"));
}

TEST_F(CliHistory, WhatTheGatewayCannotReadIsSaidInItsWords) {
  const auto id = deploy("lab1");
  site_->forget_log();
  const auto done = run({"logs", id});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("there is no log yet"));
  EXPECT_EQ(run({"describe", "nobody"}).status, 1);
  EXPECT_EQ(run({"logs"}).status, 2);
}

TEST_F(CliHistory, AGatewayWithTlsIsAskedWithTheMastersCertificateAndToken) {
  const security::test::Certificates certificates;
  const tests::TemporaryFolder folder;
  const std::string shown = folder / "shown";
  std::ofstream(shown) << "the master's\n";
  const auto site = std::make_shared<PlayedSite>();
  site->remember("1234", "active", 1000);
  rpc::ThriftServerOptions options;
  options.tls = certificates.of("lab1");
  const rpc::ThriftServer guarded(
      options, [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site)](const auto&) { return p; });
  serve("lab1", guarded.port(), true);
  const auto without = run({"history"});
  EXPECT_THAT(without.err, AllOf(HasSubstr("lab1"), HasSubstr("no certificate")));

  rpc::ThriftServerOptions api;
  api.port = server->port();
  server.reset();
  ApiAccess access;
  access.gateways = {certificates.of("lab1"), shown};
  server.emplace(api, serve_api(**master, access));
  const auto json = run_json({"history"});
  ASSERT_EQ(json.size(), 1u);
  EXPECT_EQ(json[0]["instance"], "1234");
  EXPECT_EQ(site->token(), "the master's");
}

TEST_F(CliHistory, AGatewayThatIsNotTheOneThatIsMeantDoesNotSeeTheMastersToken) {
  const security::test::Certificates certificates;
  certificates.authority().certify_host("lab2");
  certificates.authority().certify_host("shed", {.gateways = {"lab3", "lab1"}});
  const tests::TemporaryFolder folder;
  std::ofstream(folder / "lab1.token") << "for lab1 only\n";
  rpc::ThriftServerOptions api;
  api.port = server->port();
  server.reset();
  ApiAccess access;
  access.gateways = {certificates.of("lab1"), folder / "{gateway}.token"};
  server.emplace(api, serve_api(**master, access));
  const auto serve_as = [&](const std::string& certificate, const std::shared_ptr<PlayedSite>& site) {
    rpc::ThriftServerOptions options;
    options.tls = certificates.of(certificate);
    auto service = std::make_unique<rpc::ThriftServer>(
        options, [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site)](const auto&) { return p; });
    serve("lab1", service->port(), true);
    return service;
  };
  // A stolen gateway has the certificate of lab2, which is good, and the record of lab1 leads to it.
  const auto thief = std::make_shared<PlayedSite>();
  const auto stolen = serve_as("lab2", thief);
  EXPECT_THAT(run({"history"}).err, AllOf(HasSubstr("CN=lab2, not of gateway lab1"), HasSubstr("--gateway lab1")));
  EXPECT_EQ(thief->token(), "");
  // Nor does one without TLS, whatever the record says.
  serve("lab1", service_->port(), false);
  run({"history"});
  EXPECT_EQ(site_->token(), "");
  // A machine with another name whose certificate names the gateway.
  const auto site = std::make_shared<PlayedSite>();
  const auto shed = serve_as("shed", site);
  EXPECT_EQ(run({"history"}).err, "");
  EXPECT_EQ(site->token(), "for lab1 only");
}

}  // namespace
}  // namespace iotcloud::master::test
