// Which requests a browser's own page can have made, and which not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/master/console/site_rules.h>

namespace iotcloud::master {
namespace {

using testing::HasSubstr;
using testing::Not;

rpc::SiteRequest request(const std::string& method, const std::string& path,
                         std::map<std::string, std::string> headers) {
  rpc::SiteRequest made;
  made.method = method;
  made.path = path;
  made.headers = std::move(headers);
  return made;
}

ConsoleSettings on_loopback() {
  ConsoleSettings settings;
  settings.pages.address = "127.0.0.1:9114";
  return settings;
}

ConsoleSettings for_all() {
  ConsoleSettings settings;
  settings.pages.address = "0.0.0.0:9114";
  settings.pages.tls = {"ca", "certificate", "key"};
  settings.names = {"Lab1.example.org"};
  settings.others = {"https://lab2:9114"};
  return settings;
}

TEST(SiteRules, ARequestToANameOfSomebodyElseIsRefusedAlsoOnLoopback) {
  const SiteRules rules(on_loopback());
  for (const char* host : {"127.0.0.1:9114", "localhost:9114", "LOCALHOST:9114", "[::1]:9114", "localhost:2222"})
    EXPECT_EQ(rules.refusal(request("GET", "/api/me", {{"host", host}})), "") << host;
  for (const char* host : {"evil.example:9114", "127.0.0.1.evil.example", "", "localhost.evil.example:9114"})
    EXPECT_THAT(rules.refusal(request("GET", "/api/me", {{"host", host}})), HasSubstr("names: [...]")) << host;
}

TEST(SiteRules, TheNamesOfTheConfigurationAreItsNames) {
  const SiteRules rules(for_all());
  EXPECT_EQ(rules.refusal(request("GET", "/", {{"host", "lab1.example.org:9114"}})), "");
  EXPECT_NE(rules.refusal(request("GET", "/", {{"host", "lab3.example.org:9114"}})), "");
}

TEST(SiteRules, WhatChangesSomethingComesFromTheSamePage) {
  const SiteRules rules(on_loopback());
  const auto order = [&](std::map<std::string, std::string> headers) {
    headers["host"] = "localhost:9114";
    auto made = request("POST", "/api/call/order", std::move(headers));
    made.body = "{}";
    return rules.refusal(made);
  };
  const std::string json = "application/json";
  EXPECT_EQ(order({{"origin", "http://localhost:9114"}, {"content-type", json}}), "");
  EXPECT_NE(order({{"content-type", json}}), "") << "a form of an old browser says no origin";
  EXPECT_NE(order({{"origin", "http://localhost:9999"}, {"content-type", json}}), "")
      << "another program of this machine";
  EXPECT_NE(order({{"origin", "https://localhost:9114"}, {"content-type", json}}), "");
  EXPECT_NE(order({{"origin", "null"}, {"content-type", json}}), "") << "a sandboxed frame";
  EXPECT_NE(order({{"origin", "http://localhost:9114"}, {"content-type", "text/plain"}}), "") << "what a form can send";
}

TEST(SiteRules, APageOfAnotherSiteReadsNothingButMayLinkHere) {
  const SiteRules rules(on_loopback());
  const auto read = [&](const std::string& path, std::map<std::string, std::string> headers) {
    headers["host"] = "localhost:9114";
    return rules.refusal(request("GET", path, std::move(headers)));
  };
  EXPECT_NE(read("/api/live", {{"origin", "http://evil.example"}}), "");
  EXPECT_NE(read("/api/live", {{"sec-fetch-site", "cross-site"}}), "");
  EXPECT_NE(read("/console.js", {{"sec-fetch-site", "same-site"}}), "");
  EXPECT_EQ(read("/", {{"sec-fetch-site", "cross-site"}, {"sec-fetch-mode", "navigate"}}), "");
  EXPECT_NE(read("/api/me", {{"sec-fetch-site", "cross-site"}, {"sec-fetch-mode", "navigate"}}), "");
  EXPECT_EQ(read("/alive", {{"origin", "https://lab2:9114"}, {"sec-fetch-site", "cross-site"}}), "");
}

TEST(SiteRules, ThePolicyAllowsNoScriptInAPageAndReachesOnlyTheOtherMasters) {
  EXPECT_THAT(SiteRules(on_loopback()).policy(), HasSubstr("script-src 'self';"));
  EXPECT_THAT(SiteRules(on_loopback()).policy(), Not(HasSubstr("unsafe")));
  EXPECT_THAT(SiteRules(for_all()).policy(), HasSubstr("connect-src 'self' https://lab2:9114;"));
}

}  // namespace
}  // namespace iotcloud::master
