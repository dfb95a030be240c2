// describe, history and logs: what the command line has from a gateway, by way of the master.
#include <gmock/gmock.h>
#include <thrift/TProcessor.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/tests/master/cli/cli_fixture.h>

namespace iotcloud::master::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// The Thrift service of a gateway that remembers what the test says.
class PlayedSite final : public gateway::wire::TSensorSiteServiceNull {
 public:
  void getChanges(std::vector<gateway::wire::TStateChange>& answer, const std::string& instance) override {
    for (const auto& change : changes) {
      if (instance.empty() || change.instance == instance) answer.push_back(change);
    }
  }
  void readLog(gateway::wire::TLogPart& part, const std::string& instance, const std::string& position,
               std::int32_t) override {
    if (log.empty()) {
      gateway::wire::TSiteError error;
      error.__set_reason("there is no log yet");
      throw error;
    }
    if (position.empty()) part.__set_text(log + "2026 info  gateway.host: " + instance + ": active\n");
    part.__set_position("1:1");
  }
  void remember(const std::string& instance, const std::string& state, std::int64_t time_ms,
                const std::string& reason = "") {
    auto& change = changes.emplace_back();
    change.__set_instance(instance);
    change.__set_driver("turtle");
    change.__set_state(state);
    change.__set_timeMs(time_ms);
    change.__set_reason(reason);
  }

  std::vector<gateway::wire::TStateChange> changes;
  std::string log = "2026 info  gateway.host: other: active\n";
};

class CliHistory : public Cli {
 protected:
  CliHistory() {
    service_.emplace(ThriftServerOptions{}, std::make_shared<apache::thrift::TSingletonProcessorFactory>(
                                                std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site_)));
    serve("lab1", service_->port());
  }
  /// From now on the gateway's record says that its service is there.
  void serve(const std::string& gateway, int port) const {
    const discovery::Paths paths;
    auto registry = open_registry(url);
    auto record = discovery::decode_gateway(registry->get(paths.gateway(gateway))->data, gateway);
    record.host = "127.0.0.1";
    record.port = port;
    discovery::put(*registry, paths.gateway(gateway), encode(record));
  }

  FakeGateway lab1_{url, "lab1"};
  const std::shared_ptr<PlayedSite> site_ = std::make_shared<PlayedSite>();
  std::optional<ThriftServer> service_;
};

TEST_F(CliHistory, DescribeShowsTheRecordTheChannelsAndEveryChangeWithTimeAndReason) {
  const auto id = deploy("lab1");
  site_->remember(id, "starting", 1'000'000'000'000, "its driver host crashed");
  site_->remember("another", "active", 1'000'000'000'001);
  const auto done = run({"describe", id.substr(0, 8)});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out, AllOf(HasSubstr(id), HasSubstr("lab1"), HasSubstr("active"), HasSubstr("CHANNEL"),
                              HasSubstr("2001-09-09T01:46:40.000Z"), HasSubstr("its driver host crashed")));
  const auto json = run_json({"describe", id});
  EXPECT_EQ(json["instance"], id);
  ASSERT_EQ(json["history"].size(), 1u);
  EXPECT_EQ(json["history"][0]["state"], "starting");
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
  EXPECT_EQ(run_json({"history", "gone"}).size(), 2u);
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

TEST_F(CliHistory, WhatTheGatewayCannotReadIsSaidInItsWords) {
  const auto id = deploy("lab1");
  site_->log.clear();
  const auto done = run({"logs", id});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("there is no log yet"));
  EXPECT_EQ(run({"describe", "nobody"}).status, 1);
  EXPECT_EQ(run({"logs"}).status, 2);
}

}  // namespace
}  // namespace iotcloud::master::test
