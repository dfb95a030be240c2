// The console's calls have the rules and the audit log of the API.
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/console/api_calls.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::master {
namespace {

using security::Role;
using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;
using Json = nlohmann::json;

class ConsoleCallsTest : public testing::Test {
 protected:
  ConsoleCallsTest() {
    for (const auto& [name, role] :
         {std::pair{"vera", Role::viewer}, std::pair{"otto", Role::operating}, std::pair{"anna", Role::admin}})
      tokens_of_[name] = security::add_token(folder_ / "tokens", name, role);
    ApiAccess access;
    access.tokens = std::make_shared<security::TokenKeeper>(folder_ / "tokens");
    access.audit = std::make_shared<security::AuditLog>(folder_ / "audit.log");
    access.wrong_token_pause = {};
    keeper_ = access.tokens;
    EXPECT_TRUE(master_.leads());
    calls_ = calls_of_api(serve_api(*master_, std::move(access)));
  }

  ConsoleCaller caller(const std::string& name) {
    return {keeper_->holder(tokens_of_[name], ""), {}, "192.0.2.7:4711", ""};
  }
  Json call(const std::string& name, const std::string& call, const Json& arguments) {
    return Json::parse(calls_->call(caller(name), call, arguments.dump()));
  }
  std::string audit() const { return tests::read_file(folder_ / "audit.log"); }

  const tests::TemporaryFolder folder_;
  const std::string registry_ = test::fresh_registry_url();
  test::FakeGateway gateway_{registry_, "lab1"};
  test::TestMaster master_{registry_};
  std::map<std::string, std::string> tokens_of_;
  std::shared_ptr<security::TokenKeeper> keeper_;
  std::unique_ptr<ConsoleCalls> calls_;
};

TEST_F(ConsoleCallsTest, AnOrderIsCarriedOutForWhomMayGiveItAndWrittenDown) {
  const auto deployed =
      call("anna", "order", {{"order", "deploy"}, {"with", {{"plugin", "a.so"}, {"gateways", {"lab1"}}}}});
  ASSERT_TRUE(deployed.at("done")) << deployed;
  const auto instance = deployed.at("outcomes")[0].at("instance");
  EXPECT_THAT(audit(), AllOf(HasSubstr(R"("who":"anna")"), HasSubstr("192.0.2.7:4711"), HasSubstr("a.so")));
  EXPECT_TRUE(call("otto", "order", {{"order", "stop"}, {"with", {{"instances", {instance}}}}}).at("done"));
  EXPECT_THAT(audit(), HasSubstr(R"("who":"otto")"));
  const auto order = call("otto", "order_of", {{"gateway", "lab1"}, {"instance", instance}});
  EXPECT_EQ(order.at("active"), false);
}

TEST_F(ConsoleCallsTest, AskWhichPluginsGatewaysHaveAndNameThoseThatAreSilent) {
  const auto known = call("vera", "plugins", {{"gateways", {"lab1"}}});
  EXPECT_TRUE(known.at("plugins").is_array());
  EXPECT_TRUE(known.at("silent").contains("lab1")) << "the gateway of this test has no service: " << known;
}

TEST_F(ConsoleCallsTest, AnOrderOfAViewerIsRefusedAndWrittenDown) {
  const auto refused = call("vera", "order", {{"order", "stop"}, {"with", {{"instances", {"a"}}}}});
  EXPECT_TRUE(refused.at("refused"));
  EXPECT_THAT(refused.at("summary").get<std::string>(), HasSubstr("vera is viewer"));
  EXPECT_THAT(audit(), AllOf(HasSubstr(R"("event":"refused")"), HasSubstr(R"("who":"vera")")));
  EXPECT_TRUE(call("otto", "order", {{"order", "undeploy"}, {"with", {{"instances", {"a"}}}}}).at("refused"))
      << "an admin's";
  EXPECT_TRUE(call("vera", "topology", {{"topology", "echo"}, {"change", "kill"}}).at("refused"));
  EXPECT_THAT(
      [&] {
        call("vera", "order_of", {{"gateway", "lab1"}, {"instance", "a"}});
      },
      ThrowsMessage<config::Error>(HasSubstr("takes operator")));
}

TEST_F(ConsoleCallsTest, WhomeverTheTokenWasTakenFromDoesNothingMore) {
  const auto anna = caller("anna");
  ASSERT_TRUE(security::remove_token(folder_ / "tokens", "anna"));
  keeper_->reload();
  EXPECT_THAT([&] { calls_->call(anna, "status", "{}"); }, ThrowsMessage<config::Error>(HasSubstr("taken away")));
  EXPECT_NE(calls_->authenticate(anna, tokens_of_["anna"]), "");
}

TEST_F(ConsoleCallsTest, ATokenCountsAsAtTheApi) {
  const ConsoleCaller stranger{{}, {}, "192.0.2.7:4711", ""};
  EXPECT_EQ(calls_->authenticate(stranger, tokens_of_["vera"]), "");
  EXPECT_THAT(calls_->authenticate(stranger, "vera.wrong"), HasSubstr("nobody's token"));
  EXPECT_THAT(audit(), HasSubstr(R"("order":"authenticate")"));
}

TEST_F(ConsoleCallsTest, WhatIsNoCallIsRefusedWithTheReason) {
  const std::vector<std::pair<std::string, std::string>> wrong{
      {"none", "{}"}, {"order", "[]"},
      {"order", "{"}, {"history", R"({"instances":[1]})"},
      {"look", "{}"}, {"topology", R"({"topology":"a","change":"burn"})"}};
  for (const auto& [name, json] : wrong) {
    EXPECT_THROW(calls_->call(caller("anna"), name, json), config::Error) << name << json;
  }
}

}  // namespace
}  // namespace iotcloud::master
