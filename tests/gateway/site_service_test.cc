#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <regex>
#include <set>

#include <gmock/gmock.h>
#include <thrift/TApplicationException.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>
#include <unistd.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/gateway/fleet/host_metrics.h>
#include <iotcloud/gateway/host/round_trips.h>
#include <iotcloud/gateway/site_service.h>
#include <iotcloud/rpc/thrift_client.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/rpc/as_nobody.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using ::testing::HasSubstr;

/// A client of the original system, as far as the wire goes.
class SiteServiceTest : public GatewayFixture {
 protected:
  SiteServiceTest() {
    start_gateway();
    SiteService::Options options;
    options.listen.port = 0;
    options.max_message_bytes = 10000;
    options.answer_limit = tests::patience;
    service_.emplace(options, *gateway_, *registry_, paths_);
    connect();
  }
  ~SiteServiceTest() override {
    transport_->close();
    service_.reset();
  }

  /// Starts the service again, with an audit log.
  void restart_with_audit(const security::AuditSettings& audit) {
    transport_->close();
    service_.reset();
    SiteService::Options options;
    options.listen.port = 0;
    options.audit = std::make_shared<security::AuditLog>(audit);
    service_.emplace(options, *gateway_, *registry_, paths_);
    connect();
  }

  void connect() {
    namespace thrift = apache::thrift;
    transport_ = std::make_shared<thrift::transport::TFramedTransport>(
        std::make_shared<thrift::transport::TSocket>("127.0.0.1", service_->port()));
    transport_->open();
    client_.emplace(std::make_shared<thrift::protocol::TBinaryProtocol>(transport_));
  }

  TResponse deploy(const std::map<std::string, std::string>& properties = {}, const std::string& file = "probe.so",
                   const std::string& name = "") {
    discovery::wire::TSensorDeployDescriptor descriptor;
    descriptor.__set_filename(file);
    descriptor.__set_className(name);
    descriptor.__set_properties(properties);
    TResponse answer;
    client_->deploySensor(answer, descriptor);
    return answer;
  }

  /// A gateway that has just started has not made the node of its orders yet.
  bool nothing_is_ordered() {
    const auto orders = registry_->children(paths_.orders("gw"_gateway));
    return !orders || orders->empty();
  }

  std::optional<SiteService> service_;
  std::shared_ptr<apache::thrift::transport::TFramedTransport> transport_;
  std::optional<wire::TSensorSiteServiceClient> client_;
};

TEST_F(SiteServiceTest, AGatewayThatHasNotItsPlaceYetTakesNoOrders) {
  GatewayOptions options = this->options();
  options.id = "late"_gateway;
  Gateway late(std::move(options));
  SiteService::Options listen;
  listen.listen.port = 0;
  const SiteService service(listen, late, *registry_, paths_);
  transport_->close();
  namespace thrift = apache::thrift;
  transport_ = std::make_shared<thrift::transport::TFramedTransport>(
      std::make_shared<thrift::transport::TSocket>("127.0.0.1", service.port()));
  transport_->open();
  client_.emplace(std::make_shared<thrift::protocol::TBinaryProtocol>(transport_));
  const TResponse answer = deploy();
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, HasSubstr("has not registered yet"));
  EXPECT_FALSE(registry_->children(paths_.orders("late"_gateway)));
}

TEST_F(SiteServiceTest, TheGatewayWritesDownWhoGaveItOrders) {
  const tests::TemporaryFolder folder;
  security::AuditSettings audit;
  audit.file = folder / "audit.log";
  restart_with_audit(audit);
  const auto deployed = deploy();
  EXPECT_EQ(deployed.state, TResponseState::SUCCESS);
  discovery::wire::THandedMessage message;
  message.__set_instance(deployed.statusMessage);
  message.__set_channel("control");
  message.__set_payload("on");
  discovery::wire::TChannelLook look;
  client_->handMessage(look, message);
  std::ifstream in(audit.file);
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  ASSERT_EQ(lines.size(), 4u);
  EXPECT_THAT(lines[2], testing::AllOf(HasSubstr("handMessage"), HasSubstr("2 bytes for channel control of")));
  EXPECT_THAT(lines[0], testing::AllOf(HasSubstr("\"event\":\"begun\""), HasSubstr("probe.so")));
  EXPECT_THAT(lines[1], testing::AllOf(HasSubstr("\"event\":\"ended\""), HasSubstr("done")));
  EXPECT_TRUE(security::verify_audit({audit.file}, {}).findings.empty());
}

/// What a gateway says to a call of each method that its audit log has, about an instance. By method; empty: nothing.
std::map<std::string, std::string> answers_to_orders(wire::TSensorSiteServiceClient& client, const std::string& id) {
  TResponse stopped, started, deployed, undeployed;
  client.stopSensor(stopped, id);
  client.startSensor(started, id);
  discovery::wire::TSensorDeployDescriptor descriptor;
  descriptor.__set_filename("probe.so");
  client.deploySensor(deployed, descriptor);
  client.unDeploySensor(undeployed, id);
  const auto reason = [](const std::function<void()>& call) -> std::string {
    try {
      call();
    } catch (const wire::TSiteError& error) {
      return error.reason;
    }
    return "";
  };
  return {{"stopSensor", stopped.statusMessage},
          {"startSensor", started.statusMessage},
          {"deploySensor", deployed.statusMessage},
          {"unDeploySensor", undeployed.statusMessage},
          {"handMessage", reason([&] {
             discovery::wire::THandedMessage message;
             message.__set_instance(id);
             message.__set_channel("control");
             discovery::wire::TChannelLook look;
             client.handMessage(look, message);
           })},
          {"offerPlugin", reason([&] {
             wire::TPluginOffer offer;
             offer.__set_plugin("sent.so");
             std::string upload;
             client.offerPlugin(upload, offer);
           })},
          {"finishPlugin", reason([&] { client.finishPlugin("sent.so-1"); })}};
}

std::set<std::string> audited_methods() {
  std::set<std::string> methods;
  for (const auto& [name, rule] : SiteService::rules()) {
    if (rule.role >= security::Role::operating && rule.audited) methods.insert(name);
  }
  return methods;
}

TEST_F(SiteServiceTest, EachOrderHasALineWhenItBeginsAndOneWhenItEnds) {
  const tests::TemporaryFolder folder;
  security::AuditSettings audit;
  audit.file = folder / "audit.log";
  restart_with_audit(audit);
  answers_to_orders(*client_, "00000000-0000-0000-0000-000000000000");
  std::vector<std::string> order;
  std::ifstream in(audit.file);
  for (std::string line; std::getline(in, line);) {
    std::smatch found;
    ASSERT_TRUE(std::regex_search(line, found, std::regex(R"re("event":"(\w+)".*"order":"(\w+)")re"))) << line;
    order.push_back(found.str(2) + " " + found.str(1));
  }
  for (const auto& method : audited_methods()) {
    const auto begun = std::find(order.begin(), order.end(), method + " begun");
    ASSERT_NE(begun, order.end()) << method << " is not written down before it is carried out";
    EXPECT_EQ(std::find(begun + 1, order.end(), method + " ended"), begun + 1) << method;
  }
  EXPECT_EQ(order.size(), 2 * audited_methods().size());
}

TEST_F(SiteServiceTest, WithAFullDiskEveryOrderIsRefusedIfTheSettingsSaySoAndElseCarriedOut) {
  const std::string id = deploy().statusMessage;
  const auto before = record(id);
  ASSERT_EQ(before->state, DriverState::active);
  for (const bool refuse : {true, false}) {
    const tests::TemporaryFolder folder;
    security::AuditSettings audit;
    audit.file = folder / "audit.log";
    std::filesystem::create_symlink("/dev/full", audit.file);
    if (refuse) audit.when_full = security::AuditSettings::WhenFull::refuse;
    restart_with_audit(audit);
    std::set<std::string> methods;
    for (const auto& [method, answer] : answers_to_orders(*client_, id)) {
      methods.insert(method);
      const auto cannot_be_written = HasSubstr("the audit log cannot be written");
      if (refuse) {
        EXPECT_THAT(answer, cannot_be_written) << method;
      } else {
        EXPECT_THAT(answer, ::testing::Not(cannot_be_written)) << method;
      }
    }
    EXPECT_EQ(methods, audited_methods());
    const auto orders = registry_->children(paths_.orders("gw"_gateway));
    if (refuse) {
      EXPECT_THAT(*orders, ::testing::ElementsAre(id)) << "nothing was deployed, and nothing undeployed";
      EXPECT_EQ(encode(*record(id)), encode(*before)) << "it was neither stopped nor started";
    } else {
      EXPECT_THAT(*orders, ::testing::ElementsAre(::testing::Ne(id))) << "one was deployed, the other undeployed";
    }
  }
}

TEST_F(SiteServiceTest, AnInstanceIsDeployedStoppedStartedAndUndeployed) {
  const auto deployed = deploy({}, "probe.so", "camera");
  ASSERT_EQ(deployed.state, TResponseState::SUCCESS) << deployed.statusMessage;
  const std::string id = deployed.statusMessage;
  EXPECT_EQ(record(id, "camera")->state, DriverState::active);
  EXPECT_TRUE(registry_->get(paths_.order("gw"_gateway, discovery::InstanceId(id))))
      << "a call is an order in the registry";

  TResponse answer;
  client_->stopSensor(answer, id);
  EXPECT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
  EXPECT_EQ(record(id, "camera")->state, DriverState::inactive);
  client_->startSensor(answer, id);
  EXPECT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
  EXPECT_EQ(record(id, "camera")->state, DriverState::active);
  client_->unDeploySensor(answer, id);
  EXPECT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
  EXPECT_FALSE(record(id, "camera"));
}

TEST_F(SiteServiceTest, TheChangesOfAnInstanceAreToldAndSoIsWhyThereIsNoLog) {
  const auto deployed = deploy({{"channels", "none"}});
  ASSERT_EQ(deployed.state, TResponseState::SUCCESS) << deployed.statusMessage;
  std::vector<wire::TStateChange> changes;
  client_->getChanges(changes, deployed.statusMessage);
  ASSERT_EQ(changes.size(), 3u);
  EXPECT_EQ(changes[0].state, "deployed");
  EXPECT_EQ(changes[2].state, "active");
  EXPECT_GT(changes[2].timeMs, 0);
  wire::TLogPart part;
  EXPECT_THROW(client_->readLog(part, deployed.statusMessage, "", 100), wire::TSiteError);
}

TEST_F(SiteServiceTest, AChannelIsLookedAtAndAMessageIsHandedToTheDriver) {
  const auto deployed = deploy();
  ASSERT_EQ(deployed.state, TResponseState::SUCCESS) << deployed.statusMessage;
  discovery::wire::TLookRequest request;
  request.__set_instance(deployed.statusMessage);
  request.__set_channel("readings");
  request.__set_look("l");
  request.__set_most(10);
  request.__set_bytes(100);
  discovery::wire::TChannelLook look;
  client_->lookAtChannel(look, request);
  EXPECT_EQ(look.problem, "");
  EXPECT_EQ(look.state, "active");
  ASSERT_EQ(look.channels.size(), 2U);
  EXPECT_EQ(look.channels[0].name, "control");
  EXPECT_EQ(look.channels[1].brokerState, "connected");
  EXPECT_EQ(look.channels[1].waiting, 1) << "nobody reads what it sent when it was activated";
  EXPECT_TRUE(look.messages.empty());

  discovery::wire::THandedMessage message;
  message.__set_instance(deployed.statusMessage);
  message.__set_channel("control");
  message.__set_payload(std::string("by\0hand", 7));
  message.__set_properties({{"who", "anna"}});
  client_->handMessage(look, message);
  EXPECT_EQ(look.problem, "");
  discovery::wire::TChannelLook echoed;  // the probe sends on what it gets
  client_->lookAtChannel(echoed, request);
  ASSERT_EQ(echoed.messages.size(), 1U);
  EXPECT_EQ(echoed.messages[0].payload, message.payload);
  EXPECT_EQ(echoed.messages[0].properties.at("who"), "anna");

  message.__set_channel("readings");
  client_->handMessage(look, message);
  EXPECT_THAT(look.problem, HasSubstr("channel \"readings\" of instance"));
  request.__set_channel("temprature");
  discovery::wire::TChannelLook unknown;
  client_->lookAtChannel(unknown, request);
  EXPECT_THAT(unknown.problem, HasSubstr("has no channel \"temprature\"; it has \"control\" (in), \"readings\" (out)"));
  request.__set_instance("nobody");
  client_->lookAtChannel(unknown, request);
  EXPECT_THAT(unknown.problem, HasSubstr("the gateway gw has no driver instance nobody"));
}

TEST_F(SiteServiceTest, WhatDriverHostsHaveCarriedIsTold) {
  tests::HandClock clock;
  HostMetrics hosts(clock);
  const auto source = config::process_metrics().add_source([&](auto& samples) { hosts.append(samples); });
  config::Sample received;
  received.name = "iotcloud_driver_received_total";
  received.value = 3;
  std::vector<config::Sample> samples{received};
  config::Histogram round_trips;
  round_trips.record_ns(1'000'000, 2);
  append_round_trips(round_trips, "probe", samples);
  hosts.put("probe.so", 7, samples);
  clock.advance(std::chrono::milliseconds(1500));
  std::vector<wire::TCarried> told;
  client_->getCarried(told);
  std::erase_if(told, [](const auto& carried) { return carried.host.empty(); });  // of this process
  ASSERT_EQ(told.size(), 1U);
  EXPECT_EQ(told[0].host, "probe.so");
  EXPECT_EQ(told[0].ageMs, 1500);
  EXPECT_EQ(told[0].received, 3);
  EXPECT_EQ(told[0].roundTrips, (std::map<double, std::int64_t>{{1048.576, 2}}));
}

TEST_F(SiteServiceTest, AMessageThatTheDriverFailsOnIsAnsweredSo) {
  const auto deployed = deploy({{"throw_in", "message"}});
  discovery::wire::THandedMessage message;
  message.__set_instance(deployed.statusMessage);
  message.__set_channel("control");
  discovery::wire::TChannelLook look;
  client_->handMessage(look, message);
  EXPECT_THAT(look.problem, HasSubstr("the driver failed on the message"));
}

TEST_F(SiteServiceTest, AJavaClassIsNotTakenForTheDriversName) {
  const auto deployed = deploy({}, "probe.so", "cgl.iotcloud.Turtle");
  ASSERT_EQ(deployed.state, TResponseState::SUCCESS) << deployed.statusMessage;
  EXPECT_TRUE(record(deployed.statusMessage, "probe"));
}

TEST_F(SiteServiceTest, ADeploymentThatFailsSaysWhyAndIsTakenBack) {
  const auto answer = deploy({{"throw_in", "open"}});
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, HasSubstr("told to throw in open"));
  EXPECT_TRUE(eventually([&] { return nothing_is_ordered(); }));
  EXPECT_TRUE(eventually([&] { return !registry_->get(paths_.driver("probe"_driver)); }));
}

TEST_F(SiteServiceTest, AFileOutsideThePluginFolderIsRefusedWithoutAnOrder) {
  const auto answer = deploy({}, "../probe.so");
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, HasSubstr("not a plain file name"));
  EXPECT_TRUE(nothing_is_ordered());
}

TEST_F(SiteServiceTest, AnUnknownInstanceIsAFailureThatNamesIt) {
  TResponse answer;
  for (const auto call : {&wire::TSensorSiteServiceClient::startSensor, &wire::TSensorSiteServiceClient::stopSensor,
                          &wire::TSensorSiteServiceClient::unDeploySensor}) {
    ((*client_).*call)(answer, "nobody");
    EXPECT_EQ(answer.state, TResponseState::FAILURE);
    EXPECT_THAT(answer.statusMessage, HasSubstr("nobody"));
  }
  client_->unDeploySensor(answer, "../../gw2/orders/x");
  EXPECT_THAT(answer.statusMessage, HasSubstr("cannot be used as instance id"));
}

TEST_F(SiteServiceTest, TheHeartbeatCountsInstances) {
  ASSERT_EQ(deploy().state, TResponseState::SUCCESS);
  give(order("bad", {{"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("bad", DriverState::failed));
  discovery::wire::THeartBeatResponse answer;
  client_->hearbeat(answer, {});
  EXPECT_EQ(answer.totalSensors, 2);
  EXPECT_EQ(answer.responsiveSonsor, 1);
}

TEST_F(SiteServiceTest, AMessageThatIsTooLargeEndsItsConnectionAndNoOther) {
  EXPECT_THROW(deploy({{"big", std::string(20000, 'x')}}), apache::thrift::TException);
  transport_->close();
  connect();
  wire::TPing ping;
  client_->ping(ping);
  EXPECT_EQ(ping.gateway, "gw");
}

TEST_F(SiteServiceTest, EveryMethodStatesItsRole) {
  std::set<std::string> stated;
  for (const auto& [method, rule] : SiteService::rules()) stated.insert(method);
  std::ifstream in(GATEWAY_IDL);
  std::set<std::string> methods;
  bool inside = false;
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("service ")) inside = true;
    std::smatch match;
    if (inside && std::regex_search(line, match, std::regex(R"(^  [\w.<>, ]+ (\w+)\()"))) methods.insert(match[1]);
  }
  EXPECT_EQ(methods, stated);
}

TEST_F(SiteServiceTest, WithTlsAndTokensAViewerReadsAndDeploysNothing) {
  const security::test::Certificates certificates;
  const tests::TemporaryFolder folder;
  SiteService::Options options;
  options.listen = {"0.0.0.0", 0, certificates.of("lab1"), folder / "tokens", ""};
  const auto token = security::add_token(options.listen.tokens, "vera", security::Role::viewer);
  const SiteService guarded(options, *gateway_, *registry_, paths_);
  rpc::ThriftClientOptions asking;
  asking.host = "127.0.0.1";
  asking.port = guarded.port();
  asking.connect_limit = tests::patience;
  EXPECT_THROW(
      {
        wire::TPing ping;
        wire::TSensorSiteServiceClient(rpc::ThriftClient(asking).protocol()).ping(ping);
      },
      apache::thrift::TException);
  asking.tls = certificates.of("operator");
  client_.emplace(rpc::ThriftClient(asking).protocol());
  wire::TPing ping;
  EXPECT_THROW(client_->ping(ping), apache::thrift::TApplicationException);
  TResponse answer;
  client_->authenticate(answer, token);
  ASSERT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
  client_->ping(ping);
  EXPECT_EQ(ping.gateway, "gw");
  answer = deploy();
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, HasSubstr("vera is viewer"));
  client_->stopSensor(answer, "x");
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  std::string upload;
  EXPECT_THROW(client_->offerPlugin(upload, {}), wire::TSiteError);
  EXPECT_THROW(client_->sendPlugin("x", 0, "bytes"), wire::TSiteError);
  EXPECT_TRUE(nothing_is_ordered());
}

TEST_F(SiteServiceTest, OverLoopbackWithoutATokenAnotherUserReadsAndOrdersNothing) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a socket of another user";
  ASSERT_EQ(deploy().state, TResponseState::SUCCESS) << "the daemon's own user";
  const std::string id = registry_->children(paths_.orders("gw"_gateway))->at(0);
  transport_->close();
  {
    const rpc::test::AsNobody nobody;
    connect();
  }
  wire::TPing ping;
  client_->ping(ping);
  EXPECT_EQ(ping.gateway, "gw");
  std::vector<wire::TStateChange> changes;
  client_->getChanges(changes, id);
  EXPECT_FALSE(changes.empty());

  const auto refused = deploy();
  EXPECT_EQ(refused.state, TResponseState::FAILURE);
  EXPECT_THAT(refused.statusMessage, HasSubstr("be root or the daemon's own user"));
  for (const auto call : {&wire::TSensorSiteServiceClient::startSensor, &wire::TSensorSiteServiceClient::stopSensor,
                          &wire::TSensorSiteServiceClient::unDeploySensor}) {
    TResponse answer;
    ((*client_).*call)(answer, id);
    EXPECT_EQ(answer.state, TResponseState::FAILURE);
    EXPECT_THAT(answer.statusMessage, HasSubstr("be root or the daemon's own user"));
  }
  discovery::wire::THandedMessage message;
  message.__set_instance(id);
  message.__set_channel("control");
  discovery::wire::TChannelLook look;
  EXPECT_THROW(client_->handMessage(look, message), wire::TSiteError);
  std::string upload;
  EXPECT_THROW(client_->offerPlugin(upload, {}), wire::TSiteError);
  EXPECT_THROW(client_->sendPlugin("x", 0, "bytes"), wire::TSiteError);
  EXPECT_EQ(registry_->children(paths_.orders("gw"_gateway))->size(), 1U);
  EXPECT_EQ(record(id, "probe")->state, DriverState::active);
}

TEST_F(SiteServiceTest, AMastersTokenReadsAndSendsPluginsAndOrdersNothing) {
  const security::test::Certificates certificates;
  const tests::TemporaryFolder folder;
  SiteService::Options options;
  options.listen = {"0.0.0.0", 0, certificates.of("lab1"), folder / "tokens", ""};
  const auto token = security::add_token(options.listen.tokens, "master", security::Role::master, "CN=lab1");
  const SiteService guarded(options, *gateway_, *registry_, paths_);
  const auto call = [&](const std::string& certificate) {
    rpc::ThriftClientOptions asking;
    asking.host = "localhost";
    asking.port = guarded.port();
    asking.connect_limit = tests::patience;
    asking.tls = certificates.of(certificate);
    client_.emplace(rpc::ThriftClient(asking).protocol());
    TResponse answer;
    client_->authenticate(answer, token);
    return answer;
  };
  EXPECT_EQ(call("operator").state, TResponseState::FAILURE) << "a stolen token, with the thief's certificate";
  wire::TPing ping;
  EXPECT_THROW(client_->ping(ping), apache::thrift::TApplicationException);

  const auto answer = call("lab1");
  ASSERT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
  client_->ping(ping);
  EXPECT_EQ(ping.gateway, "gw");
  EXPECT_THAT(deploy().statusMessage, HasSubstr("master is master"));
  TResponse stopped;
  client_->stopSensor(stopped, "x");
  EXPECT_EQ(stopped.state, TResponseState::FAILURE);
  EXPECT_TRUE(nothing_is_ordered());
  std::string upload;
  try {
    client_->offerPlugin(upload, {});
    FAIL() << "this gateway takes no plugins";
  } catch (const wire::TSiteError& e) {
    EXPECT_THAT(e.reason, ::testing::Not(HasSubstr("takes admin"))) << "its role does allow it";
  }
}

TEST_F(SiteServiceTest, AnAddressThatOthersReachIsRefusedWithoutTlsAndTokens) {
  SiteService::Options options;
  options.listen.host = "0.0.0.0";
  options.listen.port = 0;
  EXPECT_THROW(SiteService(options, *gateway_, *registry_, paths_), config::Error);
}

}  // namespace
}  // namespace iotcloud::gateway
