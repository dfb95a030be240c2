#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/master/cli/cli_fixture.h>

namespace iotcloud::master {
namespace {

using test::Cli;
using test::FakeGateway;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

class CliMetadata : public Cli {
 protected:
  std::string deploy_with(std::vector<std::string> metadata) {
    std::vector<std::string> words{"deploy", "turtle.so", "-g", "lab1"};
    for (const auto& pair : metadata) words.insert(words.end(), {"-m", pair});
    return run_json(words)["outcomes"][0]["instance"];
  }
  FakeGateway gateway{url, "lab1"};
};

TEST_F(CliMetadata, WhereListsTheDriversForWhichItHolds) {
  const auto near = deploy_with({"site=lab", "battery=90", "location=39.1702,-86.5199"});
  const auto low = deploy_with({"site=lab", "battery=9", "location=39.1702,-86.5199"});
  const auto far = deploy_with({"site=lab", "battery=90", "location=40.1702,-86.5199"});
  const auto other = deploy_with({});

  const auto found =
      run_json({"drivers", "--where", "site == \"lab\" and battery > 20 and within(location, 39.17, -86.52, 500 m)"});
  ASSERT_THAT(found, SizeIs(1));
  EXPECT_EQ(found[0]["instance"], near);
  EXPECT_THAT(run_json({"drivers", "--where", "not exists(site)"}), SizeIs(1));
  EXPECT_THAT(run_json({"drivers", "--where", "gateway == 'lab1' and state == 'active'"}), SizeIs(4));
  EXPECT_THAT(run_json({"drivers", "--where", "battery > 20", far}), SizeIs(1));
  EXPECT_THAT(run_json({"drivers", "--where", "battery > 100"}), SizeIs(0));
  const auto table = run({"drivers", "--where", "battery < 20"});
  EXPECT_EQ(table.status, 0);
  EXPECT_THAT(table.out, AllOf(HasSubstr("METADATA"), HasSubstr(low), HasSubstr("battery=9"), Not(HasSubstr(other))));
}

TEST_F(CliMetadata, AWrongExpressionIsWrongUsageWithACaretAndNoMasterIsAsked) {
  const auto done = run({"--master", "127.0.0.1:1", "drivers", "--where", "site == lab"});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err,
              HasSubstr("iotcloud: --where, column 9: expected a number, a text in quotes, true or false, but "
                        "there is \"lab\"; write \"lab\" for a text\n  site == lab\n          ^\nQuote the"));
  EXPECT_EQ(run({"drivers", "--where", ""}).status, 2);
}

TEST_F(CliMetadata, ChangesWhatOthersSeeOfInstances) {
  const auto one = deploy_with({"site=lab", "note=old"});
  const auto two = deploy_with({"site=lab"});
  const auto done = run({"metadata", one, two, "site=roof", "note=", "say=a b=c"});
  EXPECT_EQ(done.status, 0) << done.err;
  const auto drivers = run_json({"drivers", "--where", "site == 'roof' and not exists(note) and say == 'a b=c'"});
  EXPECT_THAT(drivers, SizeIs(2));
  EXPECT_THAT(run({"drivers"}).out, HasSubstr("say=\"a b=c\" site=roof"));
}

TEST_F(CliMetadata, WantsAnIdAndAChange) {
  const auto id = deploy_with({});
  EXPECT_EQ(run({"metadata", id}).status, 2);
  EXPECT_EQ(run({"metadata", "site=lab"}).status, 2);
  EXPECT_EQ(run({"metadata", id, "=lab"}).status, 2);
  EXPECT_EQ(run({"metadata", id, "a=1", "a=2"}).status, 2);
  const auto unknown = run({"metadata", "nobody", "a=1"});
  EXPECT_EQ(unknown.status, 1);
  EXPECT_THAT(unknown.err, HasSubstr("no driver instance \"nobody\""));
}

TEST_F(CliMetadata, OrdersAreForWhatTheOptionsChooseAndForNothingElse) {
  const auto lab = deploy_with({"site=lab"});
  const auto roof = deploy_with({"site=roof"});
  EXPECT_EQ(run({"stop", "--where", "site == 'lab'"}).status, 0);
  auto inactive = run_json({"drivers", "--state", "inactive"});
  ASSERT_THAT(inactive, SizeIs(1));
  EXPECT_EQ(inactive[0]["instance"], lab);
  EXPECT_EQ(run({"metadata", "--driver", "turtle", "--state", "active", "floor=2"}).status, 0);
  const auto changed = run_json({"drivers", "--where", "floor == 2"});
  ASSERT_THAT(changed, SizeIs(1));
  EXPECT_EQ(changed[0]["instance"], roof);
  EXPECT_EQ(run({"undeploy", "--state", "inactive"}).status, 0);
  EXPECT_THAT(run_json({"drivers"}), SizeIs(1));
}

TEST_F(CliMetadata, WhatItsGatewayHasNotTakenUpIsChosenToo) {
  { const FakeGateway gone(url, "lab2"); }
  const int pending = 1;
  const auto deployed =
      run_json({"deploy", "turtle.so", "-g", "lab2", "--name", "meter", "--metadata", "site=lab"}, pending);
  ASSERT_EQ(deployed["outcomes"][0]["outcome"], "pending");
  EXPECT_EQ(run_json({"drivers"})[0]["state"], "ordered") << "it has no record yet";
  EXPECT_EQ(run_json({"stop", "meter"}, pending)["outcomes"][0]["instance"], deployed["outcomes"][0]["instance"]);
  EXPECT_EQ(run_json({"stop", "--where", "site == 'lab'"}, pending)["outcomes"][0]["outcome"], "pending");
  EXPECT_EQ(run({"stop", "--name", "meter", "--state", "active"}).status, 1);
  const auto taken = run_json({"undeploy", "--name", "meter"})["outcomes"];
  ASSERT_THAT(taken, SizeIs(1));
  EXPECT_EQ(taken[0]["instance"], deployed["outcomes"][0]["instance"]);
  EXPECT_EQ(taken[0]["outcome"], "done");
  EXPECT_EQ(run({"undeploy", "--name", "meter"}).status, 1) << "it is gone";
}

TEST_F(CliMetadata, AllOfOneGatewayCanBeTakenAwayAndThereIsNoneToTakeThen) {
  const FakeGateway second(url, "lab2");
  deploy_with({});
  deploy_with({});
  ASSERT_EQ(run({"deploy", "turtle.so", "-g", "lab2"}).status, 0);
  EXPECT_THAT(run_json({"undeploy", "--all", "--gateway", "lab1"})["outcomes"], SizeIs(2));
  const auto left = run_json({"drivers"});
  ASSERT_THAT(left, SizeIs(1));
  EXPECT_EQ(left[0]["gateway"], "lab2");
  const auto none = run({"undeploy", "--all", "--gateway", "lab1"});
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("no driver instance is chosen"));
}

}  // namespace
}  // namespace iotcloud::master
