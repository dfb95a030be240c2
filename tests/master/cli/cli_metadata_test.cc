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

}  // namespace
}  // namespace iotcloud::master
