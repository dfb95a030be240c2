// Who may do what with the master's API: tokens, roles, and what is written down of it.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <future>
#include <iterator>
#include <map>
#include <optional>
#include <regex>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <thrift/TApplicationException.h>
#include <thrift/transport/TTransportException.h>
#include <unistd.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/metrics.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/orders/order_kinds.h>
#include <iotcloud/rpc/thrift_client.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/rpc/as_nobody.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master {
namespace {

using apache::thrift::TApplicationException;
using apache::thrift::TException;
using apache::thrift::transport::TTransportException;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using rpc::RefusalForm;
using security::Role;
using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
using testing::SizeIs;

std::uint64_t refused(const std::string& reason) {
  return config::process_metrics()
      .counter("iotcloud_thrift_refused_total", "", {{"service", "api"}, {"reason", reason}})
      .value();
}

/// How each method of a service can say that it was refused, by what its IDL lets it answer.
std::map<std::string, RefusalForm> forms_of(const std::string& file, const std::string& service) {
  std::ifstream in(std::string(IOTCLOUD_SOURCE_DIR "/") + file);
  std::string text((std::istreambuf_iterator<char>(in)), {});
  text = std::regex_replace(text, std::regex("//[^\n]*"), "");
  const auto begin = text.find("service " + service);
  text = text.substr(begin, text.find('}', begin) - begin);
  std::map<std::string, RefusalForm> forms;
  const std::regex method(R"(([\w.]+|list<[^>]*>)\s+(\w+)\([^)]*\)(\s*throws)?)");
  for (std::sregex_iterator found(text.begin(), text.end(), method), end; found != end; ++found) {
    const std::string answer = (*found)[1];
    forms[(*found)[2]] = (*found)[3].matched             ? RefusalForm::error
                         : answer == "records.TResponse" ? RefusalForm::response
                         : answer.find("Response") < answer.size() && answer.find("records.") != 0
                             ? RefusalForm::order
                             : RefusalForm::failure;
  }
  return forms;
}

std::map<std::string, RefusalForm> forms_of(const rpc::MethodRules& rules) {
  std::map<std::string, RefusalForm> forms;
  for (const auto& [name, rule] : rules) forms[name] = rule.form;
  return forms;
}

class Access : public testing::Test {
 protected:
  Access() {
    EXPECT_TRUE(master_.leads());
    viewer_ = security::add_token(tokens_file_, "vera", Role::viewer);
    operating_ = security::add_token(tokens_file_, "otto", Role::operating);
    admin_ = security::add_token(tokens_file_, "anna", Role::admin);
    tokens_ = std::make_shared<security::TokenKeeper>(tokens_file_, "api", clock_, metrics_);
    audit_ = std::make_shared<security::AuditLog>(audit_file_);
    access_.tokens = tokens_;
    access_.audit = audit_;
    access_.wrong_token_pause = std::chrono::milliseconds{1};
    serve({});
  }
  void serve(const rpc::ThriftServerOptions& options) { server_.emplace(options, serve_api(*master_, access_)); }
  /// At open connections only when it is told to, so that none is cut off before its next call.
  void serve_without_looking() {
    rpc::ThriftServerOptions options;
    options.look_period = std::chrono::hours(1);
    serve(options);
  }

  /// A connection of its own, opened with the token.
  wire::TMasterAPIServiceClient connect(const std::string& token = "") {
    rpc::ThriftClientOptions options;
    options.host = "127.0.0.1";
    options.port = server_->port();
    wire::TMasterAPIServiceClient client(rpc::ThriftClient(options).protocol());
    if (!token.empty()) {
      TResponse answer;
      client.authenticate(answer, token);
      EXPECT_EQ(answer.state, TResponseState::SUCCESS) << answer.statusMessage;
    }
    return client;
  }
  static wire::TOrderResponse deploy(wire::TMasterAPIServiceClient& client) {
    wire::TDeployRequest request;
    request.plugin = "turtle.so";
    wire::TOrderResponse answer;
    client.deploy(answer, request);
    return answer;
  }
  /// The lines of the audit log, without those of orders that begin.
  std::vector<nlohmann::json> audit() const {
    auto lines = all_lines();
    std::erase_if(lines, [](const auto& line) { return line["event"] == "begun"; });
    return lines;
  }
  std::vector<nlohmann::json> all_lines() const {
    std::ifstream in(audit_file_);
    std::vector<nlohmann::json> lines;
    for (std::string line; std::getline(in, line);) lines.push_back(nlohmann::json::parse(line));
    return lines;
  }

  const tests::TemporaryFolder folder_;
  const std::string tokens_file_ = folder_ / "tokens";
  const std::string audit_file_ = folder_ / "audit.log";
  std::string viewer_, operating_, admin_;
  tests::HandClock clock_;
  config::Metrics metrics_;
  std::shared_ptr<security::TokenKeeper> tokens_;
  std::shared_ptr<security::AuditLog> audit_;
  ApiAccess access_;
  const std::string url_ = test::fresh_registry_url();
  TestMaster master_{url_};
  FakeGateway gateway_{url_, "lab1"};
  std::optional<rpc::ThriftServer> server_;
};

TEST_F(Access, EveryMethodStatesItsRoleAndHowItRefuses) {
  auto rules = forms_of(api_rules());
  const auto methods = forms_of("master/master.thrift", "TMasterAPIService");
  // A kind of order that has no method of its own has a rule too: giveOrder takes it.
  std::erase_if(rules, [&](const auto& rule) { return !methods.contains(rule.first) && find_order_kind(rule.first); });
  EXPECT_EQ(methods, rules);
}

TEST_F(Access, AnOrderThatIsGivenByNameAsksForTheRoleOfItsKind) {
  const auto give = [&](const std::string& token, const std::string& order, const std::string& json) {
    auto client = connect(token);
    wire::TOrderResponse answer;
    client.giveOrder(answer, order, json);
    return answer;
  };
  EXPECT_EQ(give(viewer_, "stop", "{}").refusal, wire::TRefusal::NOT_ALLOWED);
  const auto not_allowed = give(operating_, "deploy", R"({"plugin": "turtle.so", "gateways": ["lab1"]})");
  EXPECT_EQ(not_allowed.refusal, wire::TRefusal::NOT_ALLOWED);
  EXPECT_THAT(not_allowed.response.statusMessage, HasSubstr("deploy takes admin"));
  EXPECT_THAT(gateway_.orders(), IsEmpty());

  const auto deployed = give(admin_, "deploy", R"({"plugin": "turtle.so", "gateways": ["lab1"], "count": 2})");
  EXPECT_EQ(deployed.response.state, TResponseState::SUCCESS) << deployed.response.statusMessage;
  ASSERT_THAT(deployed.outcomes, SizeIs(2));
  const std::string chosen = R"({"instances": [")" + deployed.outcomes[0].instance + R"("]})";
  EXPECT_EQ(give(operating_, "stop", chosen).response.state, TResponseState::SUCCESS);
  EXPECT_THAT(audit().back()["what"].get<std::string>(),
              AllOf(HasSubstr("stop "), HasSubstr(deployed.outcomes[0].instance)));

  EXPECT_EQ(give(admin_, "juggle", "{}").refusal, wire::TRefusal::BAD_REQUEST);
  const auto no_order = give(admin_, "deploy", R"({"gateways": ["lab1"]})");
  EXPECT_EQ(no_order.refusal, wire::TRefusal::BAD_REQUEST);
  EXPECT_THAT(no_order.response.statusMessage, HasSubstr("the key \"plugin\" is missing"));
}

TEST_F(Access, WithoutATokenNothingIsAnswered) {
  auto client = connect();
  const auto before = refused("not_authenticated");
  std::vector<discovery::wire::TSite> gateways;
  EXPECT_THROW(client.listGateways(gateways), wire::TMasterError);
  std::vector<std::string> sites;
  EXPECT_THROW(client.getSites(sites), TApplicationException);
  EXPECT_EQ(deploy(client).refusal, wire::TRefusal::NOT_AUTHENTICATED);
  TResponse answer;
  client.stopAllSensors(answer, "x");
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, HasSubstr("authenticate"));
  EXPECT_EQ(gateway_.orders_seen(), 0);
  EXPECT_EQ(refused("not_authenticated"), before + 4);
  // A stranger writes one line for each connection.
  ASSERT_THAT(audit(), SizeIs(1));
  EXPECT_EQ(audit()[0]["order"], "listGateways");
  EXPECT_TRUE(audit()[0]["refused"]);
}

TEST_F(Access, AWrongTokenIsRefusedAndTheThirdEndsTheConnection) {
  auto client = connect();
  const auto before = refused("token");
  for (int i = 0; i < 3; ++i) {
    TResponse answer;
    client.authenticate(answer, "anna.wrong");
    EXPECT_EQ(answer.state, TResponseState::FAILURE);
  }
  TResponse answer;
  EXPECT_THROW(client.authenticate(answer, admin_), TException);
  EXPECT_EQ(refused("token"), before + 3);
  const auto lines = audit();
  ASSERT_THAT(lines, SizeIs(3));
  EXPECT_EQ(lines[0]["order"], "authenticate");
  EXPECT_TRUE(lines[0]["refused"]);
  EXPECT_THAT(lines[0].dump(), testing::Not(HasSubstr("anna.wrong")));  // what was shown is not written down
}

TEST_F(Access, ATokenOpensItsOwnConnectionOnly) {
  auto client = connect(viewer_);
  std::vector<discovery::wire::TSite> gateways;
  client.listGateways(gateways);
  EXPECT_THAT(gateways, SizeIs(1));
  auto other = connect();
  EXPECT_THROW(other.listGateways(gateways), wire::TMasterError);
}

TEST_F(Access, AViewerReadsAndChangesNothing) {
  auto client = connect(viewer_);
  std::vector<discovery::wire::TSensor> drivers;
  client.listDrivers(drivers);
  const auto before = refused("role");
  const auto deployed = deploy(client);
  EXPECT_EQ(deployed.refusal, wire::TRefusal::NOT_ALLOWED);
  EXPECT_THAT(deployed.response.statusMessage, AllOf(HasSubstr("vera is viewer"), HasSubstr("admin")));
  wire::TOrderResponse stopped;
  client.stop(stopped, {});
  EXPECT_EQ(stopped.refusal, wire::TRefusal::NOT_ALLOWED);
  wire::TOrderResponse refusal;
  client.drain(refusal, {});
  EXPECT_EQ(refusal.refusal, wire::TRefusal::NOT_ALLOWED);
  client.update(refusal, {});
  EXPECT_EQ(refusal.refusal, wire::TRefusal::NOT_ALLOWED);
  wire::TUploadResponse upload;
  client.offerPlugin(upload, {}, {});
  EXPECT_EQ(upload.refusal, wire::TRefusal::NOT_ALLOWED);
  wire::TTopologyResponse changed;
  client.orderTopology(changed, {});
  EXPECT_EQ(changed.refusal, wire::TRefusal::NOT_ALLOWED);
  std::vector<wire::TOrder> orders;  // with what drivers were deployed with, secrets too
  EXPECT_THROW(client.listOrders(orders), wire::TMasterError);
  std::string backup;
  EXPECT_THROW(client.exportOrders(backup), wire::TMasterError);
  discovery::wire::TChannelLook look;
  EXPECT_THROW(client.handMessage(look, "lab1", {}), wire::TMasterError);
  TResponse answer;
  client.unDeployAllSensor(answer, "x");
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_EQ(gateway_.orders_seen(), 0);
  EXPECT_EQ(refused("role"), before + 10);
  const auto lines = audit();
  ASSERT_THAT(lines, SizeIs(10));
  EXPECT_EQ(lines[0]["who"], "vera");
  EXPECT_EQ(lines[0]["order"], "deploy");
}

TEST_F(Access, AnOperatorStopsWhatRunsAndDeploysNothing) {
  auto admin = connect(admin_);
  const auto deployed = deploy(admin);
  ASSERT_THAT(deployed.outcomes, SizeIs(1)) << deployed.response.statusMessage;
  auto client = connect(operating_);
  EXPECT_EQ(deploy(client).refusal, wire::TRefusal::NOT_ALLOWED);
  wire::TInstanceSelection selection;
  selection.instances = {deployed.outcomes[0].instance};
  wire::TOrderResponse answer;
  client.stop(answer, selection);
  EXPECT_EQ(answer.response.state, TResponseState::SUCCESS) << answer.response.statusMessage;
  client.undeploy(answer, selection);
  EXPECT_EQ(answer.refusal, wire::TRefusal::NOT_ALLOWED);
  wire::TDeploymentChange change;
  change.instances = selection.instances;
  change.__set_properties({{"password", "other"}});
  client.changeDeployment(answer, change);
  EXPECT_EQ(answer.refusal, wire::TRefusal::NOT_ALLOWED);
  std::vector<wire::TOrder> orders;
  client.listOrders(orders);
  EXPECT_THAT(orders, SizeIs(1));
  std::string backup;
  EXPECT_THROW(client.exportOrders(backup), wire::TMasterError);
  admin.exportOrders(backup);
  EXPECT_THAT(backup, HasSubstr(selection.instances.at(0)));
  const auto lines = audit();
  EXPECT_EQ(lines.back()["order"], "exportOrders");
}

TEST_F(Access, OnlyAnAdminIsToldSecretsThatDriversWereDeployedWith) {
  auto admin = connect(admin_), operating = connect(operating_);
  wire::TDeployRequest request;
  request.plugin = "camera.so";
  request.properties = {{"rate", "5"}, {"password", "sesame"}, {"source", "rtsp://admin:sesame@camera/1"}};
  wire::TOrderResponse answer;
  admin.deploy(answer, request);
  ASSERT_EQ(answer.response.state, TResponseState::SUCCESS);
  std::vector<wire::TOrder> orders;
  admin.listOrders(orders);
  ASSERT_THAT(orders, SizeIs(1));
  EXPECT_EQ(orders[0].properties, request.properties);
  EXPECT_THAT(orders[0].hidden, IsEmpty());
  operating.listOrders(orders);
  ASSERT_THAT(orders, SizeIs(1));
  EXPECT_THAT(orders[0].properties, ElementsAre(Pair("rate", "5")));
  EXPECT_THAT(orders[0].hidden, ElementsAre("password", "source"));
}

TEST_F(Access, AnOrderIsWrittenDownWithWhoGaveItAndWhatBecameOfIt) {
  auto client = connect(admin_);
  ASSERT_EQ(deploy(client).response.state, TResponseState::SUCCESS);
  gateway_.behave(FakeGateway::fail("no such plugin"));
  deploy(client);
  const auto lines = audit();
  ASSERT_THAT(lines, SizeIs(2));
  EXPECT_EQ(lines[0]["who"], "anna");
  EXPECT_EQ(lines[0]["role"], "admin");
  EXPECT_EQ(lines[0]["order"], "deploy");
  EXPECT_THAT(lines[0]["what"].get<std::string>(), HasSubstr("turtle.so"));
  EXPECT_THAT(lines[0]["address"].get<std::string>(), HasSubstr("127.0.0.1:"));
  EXPECT_TRUE(
      std::regex_match(lines[0]["time"].get<std::string>(), std::regex(R"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z)")));
  EXPECT_FALSE(lines[0]["refused"]);
  EXPECT_THAT(lines[1]["outcome"].get<std::string>(), HasSubstr("no such plugin"));
}

TEST_F(Access, EveryOrderIsWrittenDownBeforeItIsCarriedOut) {
  auto client = connect(admin_);
  ASSERT_EQ(deploy(client).response.state, TResponseState::SUCCESS);
  TResponse response;
  client.deploySensor(response, {}, {});
  client.unDeploySensor(response, {}, "x");
  client.unDeployAllSensor(response, "x");
  client.startSensor(response, {}, "x");
  client.startAllSensor(response, "x");
  client.stopSiteSensors(response, {}, "x");
  client.stopAllSensors(response, "x");
  wire::TOrderResponse answer;
  client.undeploy(answer, {});
  client.start(answer, {});
  client.stop(answer, {});
  client.updateMetadata(answer, {}, {});
  client.changeDeployment(answer, {});
  client.drain(answer, {});
  client.undrain(answer, {});
  client.update(answer, {});
  client.giveOrder(answer, "stop", R"({"instances": []})");
  wire::TTopologyResponse changed;
  client.orderTopology(changed, {});
  wire::TUploadResponse upload;
  client.offerPlugin(upload, {}, {});
  client.offerLibrary(upload, {});
  client.finishPlugin(upload, "x");
  std::string backup;
  client.exportOrders(backup);
  discovery::wire::TChannelLook look;
  EXPECT_THROW(client.handMessage(look, "nowhere", {}), wire::TMasterError);
  std::map<std::string, int> begun, ended;
  for (const auto& line : all_lines()) ++(line["event"] == "begun" ? begun : ended)[line["order"]];
  EXPECT_EQ(begun, ended);
  for (const auto& [name, rule] : api_rules()) {
    const bool has_method = forms_of("master/master.thrift", "TMasterAPIService").contains(name);
    if (rule.role < Role::operating || !rule.audited || !has_method) continue;
    EXPECT_EQ(begun[name], 1) << name << " is not written down before it is carried out";
  }
}

TEST_F(Access, WithAFullDiskOrdersAreRefusedIfTheSettingsSaySo) {
  bool full = false;
  audit_ = std::make_shared<security::AuditLog>(
      security::AuditSettings{folder_ / "strict.log", security::AuditSettings::WhenFull::refuse}, [&](int) {
        errno = ENOSPC;
        return !full;
      });
  ApiAccess access;
  access.tokens = tokens_;
  access.audit = audit_;
  server_.emplace(rpc::ThriftServerOptions{}, serve_api(*master_, access));
  auto client = connect(admin_);
  EXPECT_EQ(deploy(client).response.state, TResponseState::SUCCESS);
  const int before = gateway_.orders_seen();
  full = true;
  EXPECT_THROW(deploy(client), TException);
  wire::TOrderResponse answer;
  client.giveOrder(answer, "deploy", R"({"plugin": "turtle.so", "gateways": ["lab1"]})");
  EXPECT_THAT(answer.response.statusMessage, HasSubstr("the audit log cannot be written"));
  EXPECT_EQ(gateway_.orders_seen(), before);
}

/// What one caller may take of the API, shown at a server with low limits.
class LimitedAccess : public Access {
 protected:
  /// \return why the call was refused; empty: it was answered
  static std::string refusal(wire::TMasterAPIServiceClient& client) {
    try {
      wire::TMasterStatus status;
      client.getStatus(status);
      return "";
    } catch (const wire::TMasterError& error) {
      return error.reason;
    }
  }
  static bool is_answered(wire::TMasterAPIServiceClient& client) {
    try {
      return refusal(client).empty();
    } catch (const TException&) {
      return false;
    }
  }
  /// Waits until the server closes the connection. \return false if it does not, or says something
  static bool is_closed(wire::TMasterAPIServiceClient& client) {
    std::uint8_t byte = 0;
    try {
      return client.getInputProtocol()->getTransport()->read(&byte, 1) == 0;
    } catch (const TTransportException& error) {
      return error.getType() == TTransportException::END_OF_FILE;
    }
  }
  const std::string other_ = security::add_token(tokens_file_, "vito", Role::viewer);
  const rpc::CallLimits::Options few_{.at_once = 16,
                                      .per_second = 0.001,
                                      .saved = std::chrono::seconds{3'000},
                                      .longest_wait = std::chrono::milliseconds{0}};
};

TEST_F(LimitedAccess, AViewerWhoCallsTooOftenIsRefusedOnAllConnectionsAndOthersAreAnswered) {
  access_.calls[Role::viewer] = few_;
  serve({});
  tokens_->reload();
  auto first = connect(viewer_), other = connect(other_), admin = connect(admin_);
  const auto before = refused("rate");
  int answered = 0;
  while (answered < 100 && refusal(first).empty()) ++answered;
  EXPECT_THAT(answered, AllOf(testing::Ge(1), testing::Le(4)));
  EXPECT_EQ(refused("rate"), before + 1);
  auto second = connect(viewer_);
  EXPECT_THAT(refusal(second), HasSubstr("vera makes too many calls"));
  EXPECT_EQ(refusal(other), "");
  for (int i = 0; i < 20; ++i) EXPECT_EQ(refusal(admin), "");
}

TEST_F(LimitedAccess, EachIdentityOfEveryRoleHasALimitOfItsOwn) {
  const auto second_admin = security::add_token(tokens_file_, "anton", Role::admin);
  access_.calls[Role::operating] = access_.calls[Role::admin] = few_;
  serve({});
  tokens_->reload();
  for (const auto& [token, name] : {std::pair(operating_, "otto"), std::pair(admin_, "anna")}) {
    auto client = connect(token);
    int answered = 0;
    while (answered < 100 && refusal(client).empty()) ++answered;
    EXPECT_THAT(answered, AllOf(testing::Ge(1), testing::Le(4))) << name;
    auto again = connect(token);
    EXPECT_THAT(refusal(again), HasSubstr(std::string(name) + " makes too many calls"));
  }
  auto viewer = connect(viewer_), anton = connect(second_admin);
  EXPECT_EQ(refusal(viewer), "");
  EXPECT_EQ(refusal(anton), "");
}

TEST_F(LimitedAccess, AnOrderThatIsGivenByNameCountsOnce) {
  access_.calls[Role::admin] = few_;
  serve({});
  auto admin = connect(admin_);
  wire::TOrderResponse answer;
  int given = 0;
  for (; given < 100; ++given) {
    admin.giveOrder(answer, "undeploy", R"({"instances": ["nobody"]})");
    if (answer.response.statusMessage.find("too many calls") != std::string::npos) break;
  }
  EXPECT_THAT(given, AllOf(testing::Ge(2), testing::Le(4)));
}

TEST_F(LimitedAccess, OneWhoTriesTokensWithoutEndIsRefusedBeforeTheyAreHashedAndThoseWhoAreKnownGetIn) {
  access_.token_tries = std::make_shared<rpc::CallLimits>(few_);
  serve({});
  connect(admin_);
  const auto answer_to = [this](const std::string& token) {
    auto client = connect();
    TResponse answer;
    client.authenticate(answer, token);
    return answer.statusMessage;
  };
  const auto before = refused("token_rate");
  std::string answer;
  for (int i = 0; i < 10 && answer.find("too many") == std::string::npos; ++i) answer = answer_to("vera.wrong");
  EXPECT_THAT(answer, HasSubstr("tries too many tokens"));
  EXPECT_THAT(answer_to(viewer_), HasSubstr("tries too many tokens")) << "of the same user, and never shown before";
  EXPECT_GE(refused("token_rate"), before + 2);
  connect(admin_);
  if (geteuid() != 0) return;
  const rpc::test::AsNobody other_user;
  connect(operating_);
}

TEST_F(LimitedAccess, AWrongTokensPauseHoldsUpNoOtherTryOfItsCaller) {
  access_.token_tries = std::make_shared<rpc::CallLimits>(
      rpc::CallLimits::Options{.at_once = 1, .per_second = 1e6, .longest_wait = std::chrono::milliseconds{0}});
  access_.wrong_token_pause = std::chrono::seconds{2};
  serve({});
  const auto before = refused("token");
  std::jthread wrong([client = connect()]() mutable {
    TResponse answer;
    client.authenticate(answer, "vera.wrong");
  });
  ASSERT_TRUE(tests::eventually([&] { return refused("token") == before + 1; }));
  connect(viewer_);
}

TEST_F(LimitedAccess, WhoseTokenIsFoundGoodWhileItWaitsForItsTurnGetsIn) {
  tests::HandClock turns;
  const rpc::CallLimits::Options one{.at_once = 1, .per_second = 1e6, .longest_wait = std::chrono::seconds{5}};
  access_.token_tries = std::make_shared<rpc::CallLimits>(one, turns);
  serve({});
  const auto other_try = access_.token_tries->enter(fmt::format("user {}", geteuid()));
  std::jthread waiting([this] { connect(viewer_); });
  ASSERT_TRUE(tests::eventually([&] { return turns.waiting() == 1; }));
  ASSERT_TRUE(tokens_->holder(viewer_, "")) << "by another connection";
  turns.advance(one.longest_wait);
}

TEST_F(LimitedAccess, RefusedCallsCountToo) {
  access_.calls[Role::viewer] = few_;
  serve({});
  auto client = connect(viewer_);
  std::string answer;
  for (int i = 0; i < 10 && answer.find("too many") == std::string::npos; ++i)
    answer = deploy(client).response.statusMessage;
  EXPECT_THAT(answer, HasSubstr("vera makes too many calls"));
}

TEST_F(LimitedAccess, OneTokenHasSoManyConnectionsAndTakesNobodysPlace) {
  rpc::ThriftServerOptions options;
  options.max_connections = 8;
  options.max_connections_of_one = 3;
  serve(options);
  auto admin = connect(admin_);
  ASSERT_TRUE(is_answered(admin));
  std::vector<wire::TMasterAPIServiceClient> all;
  for (int i = 0; i < 20; ++i) {
    // The server refuses one while it has not noted yet that it has answered the others.
    ASSERT_TRUE(tests::eventually([&] {
      try {
        all.push_back(connect(viewer_));
        return true;
      } catch (const TTransportException&) {
        return false;
      }
    }));
    ASSERT_TRUE(is_answered(all.back()));
  }
  auto operating = connect(operating_);  // the server looks when the next one comes
  EXPECT_TRUE(is_answered(operating));
  EXPECT_TRUE(is_answered(admin));
  // Which three depends on when their threads noted that they were idle.
  EXPECT_EQ(std::count_if(all.begin(), all.end(), [](auto& client) { return is_answered(client); }), 3);
}

TEST_F(LimitedAccess, OneThatSaysNothingIsClosedWithATokenToo) {
  rpc::ThriftServerOptions without_token;
  without_token.stranger_limit = std::chrono::milliseconds{50};
  serve(without_token);
  auto stranger = connect();
  EXPECT_TRUE(is_closed(stranger));
  rpc::ThriftServerOptions with_token;
  with_token.idle_limit = std::chrono::milliseconds{50};
  serve(with_token);
  auto idle = connect(admin_);
  EXPECT_TRUE(is_closed(idle));
}

TEST_F(Access, AViewersFloodOfRefusedCallsFillsNoDisk) {
  auto client = connect(viewer_);
  for (int i = 0; i < 200; ++i) deploy(client);
  EXPECT_THAT(audit().size(), testing::Le(30u));
}

TEST_F(Access, AHugeMessageOfAViewerOrAnOperatorEndsItsConnectionUnreadAndAnAdminsIsAnswered) {
  const std::string huge = R"({"plugin": "turtle.so", "gateways": ["lab1"])" + std::string(2 << 20, ' ') + "}";
  const auto give = [&](const std::string& token) {
    auto client = connect(token);
    wire::TOrderResponse answer;
    client.giveOrder(answer, "deploy", huge);
    return answer;
  };
  const auto& too_large = config::process_metrics().counter("iotcloud_thrift_refused_total", "",
                                                            {{"service", "thrift"}, {"reason", "size"}});
  for (const auto& token : {viewer_, operating_}) {
    const auto before = too_large.value();
    EXPECT_THROW(give(token), TTransportException);
    EXPECT_EQ(too_large.value(), before + 1);
  }
  EXPECT_THAT(all_lines(), IsEmpty());
  const auto answer = give(admin_);
  EXPECT_EQ(answer.refusal, wire::TRefusal::BAD_REQUEST);
  EXPECT_THAT(answer.response.statusMessage,
              HasSubstr(std::to_string(huge.size()) + " bytes are more than it may have"));
  EXPECT_EQ(gateway_.orders_seen(), 0);
}

TEST_F(Access, AViewerSeesNoBrokersPassword) {
  auto admin = connect(admin_);
  ASSERT_EQ(deploy(admin).response.state, TResponseState::SUCCESS);
  auto client = connect(viewer_);
  std::vector<discovery::wire::TSensor> listed, all, of_gateway;
  client.listDrivers(listed);
  client.getAllSensors(all);
  client.getSensors(of_gateway, "lab1");
  for (const auto* drivers : {&listed, &all, &of_gateway}) {
    ASSERT_THAT(*drivers, SizeIs(1));
    ASSERT_THAT(drivers->at(0).channels, SizeIs(1));
    EXPECT_EQ(drivers->at(0).channels[0].brokerUrl, "amqp://robot:***@127.0.0.1:5672/");
    EXPECT_EQ(drivers->at(0).channels[0].properties.at("urls"), "***") << "also not among several";
  }
}

std::size_t threads_of_this_process() {
  const std::filesystem::directory_iterator threads("/proc/self/task");
  return static_cast<std::size_t>(std::distance(begin(threads), end(threads)));
}

TEST_F(Access, AViewersQuestionToManySilentGatewaysTakesFewThreads) {
  constexpr std::size_t many = 24, most = 16;  // GatewayAsks
  const tests::LoopbackListener silent;
  std::vector<std::unique_ptr<FakeGateway>> gateways;
  const discovery::Paths paths;
  const auto registry = test::open_registry(url_);
  for (std::size_t i = 0; i < many; ++i) {
    const discovery::GatewayId id("silent" + std::to_string(i));
    gateways.push_back(std::make_unique<FakeGateway>(url_, id.str()));
    auto record = discovery::decode_gateway(registry->get(paths.gateway(id))->data, id.str());
    record.host = "127.0.0.1";
    record.port = silent.port();
    discovery::put(*registry, paths.gateway(id), encode(record));
  }
  auto client = connect(viewer_);
  const std::size_t before = threads_of_this_process();
  wire::TDriverHistory history;
  auto answer = std::async(std::launch::async, [&] { client.getHistory(history, {}, {}, 10); });
  std::size_t peak = 0;
  while (answer.wait_for(std::chrono::milliseconds(1)) != std::future_status::ready)
    peak = std::max(peak, threads_of_this_process());
  answer.get();
  EXPECT_GE(history.silent.size(), many);
  EXPECT_GE(peak, before + most);
  EXPECT_LE(peak, before + most + 2) << "that of this question, and the test's own";
}

class LoopbackAccess : public Access {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "only root can make a socket of another user";
  }
  void serve(ApiAccess access) {
    access.audit = audit_;
    server_.emplace(rpc::ThriftServerOptions{}, serve_api(*master_, access));
  }
  wire::TOrderResponse deploy_as_nobody() {
    std::optional<wire::TMasterAPIServiceClient> client;
    {
      const rpc::test::AsNobody nobody;
      client.emplace(connect());
    }
    std::vector<discovery::wire::TSensor> drivers;
    client->listDrivers(drivers);  // reading is for all
    return deploy(*client);
  }
};

TEST_F(LoopbackAccess, WithoutATokenADriverOfAnotherUserReadsAndGivesNoOrders) {
  serve({});
  const auto refused = deploy_as_nobody();
  EXPECT_EQ(refused.refusal, wire::TRefusal::NOT_ALLOWED);
  EXPECT_THAT(refused.response.statusMessage, HasSubstr("be root or the daemon's own user"));
  EXPECT_EQ(gateway_.orders_seen(), 0);
  EXPECT_EQ(audit().back()["who"], "user 65534");
  auto own = connect();
  EXPECT_EQ(deploy(own).response.state, TResponseState::SUCCESS);
}

TEST_F(LoopbackAccess, WithoutATokenOneUsersConnectionsTakeNobodysPlace) {
  rpc::ThriftServerOptions options;
  options.max_connections = 8;
  options.max_connections_of_one = 3;
  server_.emplace(options, serve_api(*master_, ApiAccess{}));
  const auto answers = [](wire::TMasterAPIServiceClient& client) {
    try {
      wire::TMasterStatus status;
      client.getStatus(status);
      return true;
    } catch (const TException&) {
      return false;
    }
  };
  auto own = connect();
  ASSERT_TRUE(answers(own));
  std::vector<wire::TMasterAPIServiceClient> all;
  for (int i = 0; i < 20; ++i) {
    const rpc::test::AsNobody nobody;
    all.push_back(connect());
    ASSERT_TRUE(answers(all.back()));
  }
  auto next = connect();  // the server looks when the next one comes
  EXPECT_TRUE(answers(next));
  EXPECT_TRUE(answers(own));
  int open = 0;
  for (auto& client : all) open += answers(client) ? 1 : 0;
  EXPECT_EQ(open, 3);
}

TEST_F(LoopbackAccess, AnAccountThatTheConfigurationNamesMayAct) {
  ApiAccess access;
  access.users = {"no-such-account", "nobody"};
  serve(access);
  EXPECT_EQ(deploy_as_nobody().response.state, TResponseState::SUCCESS);
}

TEST_F(LoopbackAccess, OpenLetsEverybodyActForProgramsOfTheOriginal) {
  ApiAccess access;
  access.open = true;
  serve(access);
  EXPECT_EQ(deploy_as_nobody().response.state, TResponseState::SUCCESS);
}

TEST_F(Access, AnAuditLogThatIsMovedAwayIsBegunAnew) {
  auto client = connect(admin_);
  deploy(client);
  std::filesystem::rename(audit_file_, audit_file_ + ".1");
  audit_->reopen();
  deploy(client);
  EXPECT_THAT(audit(), SizeIs(1));
  EXPECT_THAT(security::verify_audit({audit_file_ + ".1", audit_file_}, {}).findings, IsEmpty());
}

TEST_F(Access, OneWhoseTokenIsTakenAwayLosesItsOpenConnection) {
  rpc::ThriftServerOptions options;
  options.look_period = std::chrono::milliseconds(20);
  serve(options);
  auto client = connect(viewer_);
  auto other = connect(admin_);
  const auto& cut_off = config::process_metrics().counter("iotcloud_thrift_refused_total", "",
                                                          {{"service", "thrift"}, {"reason", "revoked"}});
  const auto before = cut_off.value();
  security::remove_token(tokens_file_, "vera");
  clock_.advance(security::TokenKeeper::look_period);
  ASSERT_TRUE(tests::eventually([&] { return cut_off.value() == before + 1; })) << "nobody told the server";
  std::vector<discovery::wire::TSite> gateways;
  EXPECT_THROW(client.listGateways(gateways), apache::thrift::transport::TTransportException);
  EXPECT_NO_THROW(other.listGateways(gateways));
}

TEST_F(Access, OneWhoseTokenExpiresLosesItsOpenConnectionAndIsToldWhyUntilItIsRenewed) {
  serve_without_looking();
  const auto end = clock_.wall_ms() / 1000 + 3600;
  const auto token = security::add_token(tokens_file_, "eva", Role::admin, "", end);
  tokens_->reload();
  auto kept = connect(token);
  auto client = connect(token);
  EXPECT_EQ(deploy(client).response.state, TResponseState::SUCCESS);
  const auto& cut_off = config::process_metrics().counter("iotcloud_thrift_refused_total", "",
                                                          {{"service", "thrift"}, {"reason", "revoked"}});
  const auto before = cut_off.value();
  clock_.advance(std::chrono::hours(1));
  const auto refused = deploy(client);
  EXPECT_EQ(refused.refusal, wire::TRefusal::NOT_AUTHENTICATED);
  EXPECT_THAT(refused.response.statusMessage, HasSubstr("expired"));
  server_->reload();  // it looks at open connections every few seconds, and now
  ASSERT_TRUE(tests::eventually([&] { return cut_off.value() == before + 2; }));
  std::vector<discovery::wire::TSite> gateways;
  EXPECT_THROW(kept.listGateways(gateways), apache::thrift::transport::TTransportException);
  TResponse answer;
  auto again = connect();
  again.authenticate(answer, token);
  EXPECT_EQ(answer.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.statusMessage, AllOf(HasSubstr("eva expired 2020-01-01 01:00:00 UTC"), HasSubstr("token renew")));

  ASSERT_TRUE(security::renew_token(tokens_file_, "eva", end + 3600));
  tokens_->reload();
  auto renewed = connect(token);
  EXPECT_EQ(deploy(renewed).response.state, TResponseState::SUCCESS);
}

TEST_F(Access, OneWhoseTokenIsTakenAwayMayDoNothingMore) {
  serve_without_looking();
  auto client = connect(admin_);
  EXPECT_EQ(deploy(client).response.state, TResponseState::SUCCESS);
  security::remove_token(tokens_file_, "anna");
  tokens_->reload();
  const auto answer = deploy(client);
  EXPECT_EQ(answer.refusal, wire::TRefusal::NOT_AUTHENTICATED);
  EXPECT_THAT(answer.response.statusMessage, HasSubstr("taken away"));
}

}  // namespace
}  // namespace iotcloud::master
