// What gateways tell a master: one that somebody has stolen tells it as much as it likes.
#include <algorithm>
#include <memory>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
using testing::SizeIs;

/// The Thrift service of a gateway that remembers this many changes.
class TalkativeSite final : public gateway::wire::TSensorSiteServiceNull {
 public:
  TalkativeSite(std::string id, std::size_t changes, std::size_t reason)
      : id_(std::move(id)), changes_(changes), reason_(reason) {}
  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway(id_); }
  void getChanges(std::vector<gateway::wire::TStateChange>& answer, const std::string&) override {
    for (std::size_t i = 0; i < changes_; ++i) {
      auto& change = answer.emplace_back();
      change.__set_instance(id_ + "-instance");
      change.__set_timeMs(static_cast<std::int64_t>(i));
      change.__set_reason(std::string(reason_, 'x'));
    }
  }

 private:
  const std::string id_;
  const std::size_t changes_, reason_;
};

class GatewayPages : public testing::Test {
 protected:
  GatewayPages() {
    access_.answer_limit = access_.all_answers_limit = tests::patience;  // a busy machine writes megabytes slowly
    EXPECT_TRUE(master_.leads());
  }
  void serve(const std::string& id, std::size_t changes, std::size_t reason) {
    gateways_.push_back(std::make_unique<FakeGateway>(url_, id));
    rpc::ThriftServerOptions options;
    options.message_limit = tests::patience;
    services_.push_back(std::make_unique<rpc::ThriftServer>(
        options, [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(
                      std::make_shared<TalkativeSite>(id, changes, reason))](const auto&) { return p; }));
    const std::string path = discovery::Paths().gateway(discovery::GatewayId(id));
    auto record = discovery::decode_gateway(master_.registry().get(path)->data, id);
    record.host = "127.0.0.1";
    record.port = services_.back()->port();
    discovery::put(master_.registry(), path, encode(record));
    EXPECT_TRUE(test::eventually([&] {
      const auto known = master_->gateways();
      return std::any_of(known.begin(), known.end(),
                         [&](const auto& one) { return one.record.id == id && one.record.port == record.port; });
    }));
  }
  DriverHistory history(std::int32_t most = 0) { return read_history(*master_, access_, asks_, {}, {}, most); }

  const std::string url_ = test::fresh_registry_url();
  TestMaster master_{url_};
  std::vector<std::unique_ptr<FakeGateway>> gateways_;
  std::vector<std::unique_ptr<rpc::ThriftServer>> services_;
  GatewayAccess access_;
  GatewayAsks asks_;
};

TEST_F(GatewayPages, AnAnswerThatIsTooLargeIsNotReadAndItsGatewayNamed) {
  serve("lab1", 3, 10);
  serve("stolen", 1, 9 << 20);
  const auto told = history();
  EXPECT_THAT(told.changes, SizeIs(3));
  EXPECT_THAT(told.silent, ElementsAre(Pair("stolen"_gateway, AllOf(HasSubstr("gateway stolen at 127.0.0.1:"),
                                                                    HasSubstr("more than 8 MB")))));
}

TEST_F(GatewayPages, AListWithoutEndIsNotReadAndItsGatewayNamed) {
  serve("stolen", 10'000, 900);
  EXPECT_THAT(history().silent, ElementsAre(Pair("stolen"_gateway, HasSubstr("more than 8 MB"))));
}

TEST_F(GatewayPages, AnswersThatAreTooLargeTogetherAreLeftOutAndTheirGatewaysNamed) {
  for (int i = 0; i < 9; ++i) serve("lab" + std::to_string(i), 1, 7'500'000);
  const auto told = history();
  EXPECT_THAT(told.changes, SizeIs(8));
  ASSERT_THAT(told.silent, SizeIs(1));
  EXPECT_THAT(told.silent.begin()->second, AllOf(HasSubstr("60 MB together"), HasSubstr("alone")));
  EXPECT_THAT(read_history(*master_, access_, asks_, {}, {told.silent.begin()->first}, 0).changes, SizeIs(1));
}

TEST_F(GatewayPages, OfManyChangesOnlyTheLatestAreKeptHoweverManyGatewaysTellThem) {
  for (int i = 0; i < 9; ++i) serve("lab" + std::to_string(i), 600, 12'000);  // more than 60 MB
  const auto told = history(10);
  EXPECT_THAT(told.silent, IsEmpty());
  ASSERT_THAT(told.changes, SizeIs(10));
  for (const auto& change : told.changes) EXPECT_GE(change.time_ms, 598);
}

}  // namespace
}  // namespace iotcloud::master
