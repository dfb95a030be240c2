// An old plugin that was signed once does not come back.
#include <atomic>
#include <filesystem>
#include <future>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/security/plugin_versions.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/security/key_folder.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::security {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// Stands still until a test moves it.
struct VersionsClock final : config::Clock {
  Instant now() const override { return {}; }
  std::int64_t wall_ms() const override { return ms; }
  std::int64_t ms = 1'000'000;
};

class PluginVersionsTest : public KeyFolder {
 protected:
  PluginVersions versions() const { return PluginVersions(options_, clock_); }
  static std::string refusal(PluginVersions& versions, std::uint64_t version, const std::string& file = "turtle.so",
                             bool of_update = false) {
    PluginSignature signature;
    if (version > 0) signature.name = "turtle";
    signature.version = version;
    return error_of([&] { versions.admit(file, signature, of_update); });
  }

  VersionsClock clock_;
  PluginVersions::Options options_{folder_ / "plugin-versions", {}, false};
};

TEST_F(PluginVersionsTest, AnOlderVersionThanOneThatRanDoesNotRunAlsoUnderAnotherFileAndAfterARestart) {
  {
    auto known = versions();
    EXPECT_THAT(refusal(known, 1), IsEmpty());
    EXPECT_THAT(refusal(known, 3), IsEmpty());
    EXPECT_THAT(refusal(known, 3), IsEmpty());
    EXPECT_THAT(refusal(known, 2), HasSubstr("version 2 of turtle is older than version 3, which ran here"));
  }
  auto known = versions();
  EXPECT_THAT(refusal(known, 2, "harmless.so"), HasSubstr("is older"));
  EXPECT_THAT(refusal(known, 4), IsEmpty());
}

TEST_F(PluginVersionsTest, AVersionThatRanDoesNotWaitUntilANewerOneIsOnTheDisk) {
  auto known = versions();
  EXPECT_THAT(refusal(known, 1), IsEmpty());
  std::promise<void> go_on;
  std::atomic<bool> writing{false};
  const tests::SyncCalls slow([&, let_go = go_on.get_future().share()](const std::string&) {
    writing = true;
    let_go.wait();
    return 0;
  });
  auto newer = std::async(std::launch::async, [&] { return refusal(known, 3); });
  auto newest = std::async(std::launch::async, [&] { return refusal(known, 4); });
  EXPECT_TRUE(tests::eventually([&] { return writing.load(); }));
  auto former = std::async(std::launch::async, [&] { return refusal(known, 1); });
  EXPECT_EQ(former.wait_for(tests::patience), std::future_status::ready);
  go_on.set_value();
  EXPECT_THAT(former.get(), IsEmpty());
  EXPECT_THAT(newest.get(), IsEmpty());
  EXPECT_THAT(newer.get(), AnyOf(IsEmpty(), HasSubstr("is older"))) << "it may come second";
  auto restarted = versions();
  EXPECT_THAT(refusal(restarted, 4), IsEmpty());
  EXPECT_THAT(refusal(restarted, 2), HasSubstr("older than version 4"));
}

TEST_F(PluginVersionsTest, AnUpdateMayGoBackForAWhileToTheVersionBefore) {
  auto known = versions();
  EXPECT_THAT(refusal(known, 1), IsEmpty());
  EXPECT_THAT(refusal(known, 2, "turtle.so", true), IsEmpty());
  EXPECT_THAT(refusal(known, 1), IsEmpty()) << "the update failed";
  auto restarted = versions();
  EXPECT_THAT(refusal(restarted, 1), IsEmpty());
  clock_.ms += options_.way_back.count();
  EXPECT_THAT(refusal(known, 1), HasSubstr("is older"));
}

TEST_F(PluginVersionsTest, WhatNoUpdateBroughtLeavesNoWayBack) {
  auto known = versions();
  EXPECT_THAT(refusal(known, 1), IsEmpty());
  EXPECT_THAT(refusal(known, 2), IsEmpty());
  EXPECT_THAT(refusal(known, 1), HasSubstr("is older"));
  EXPECT_THAT(refusal(known, 1, "turtle.so", true), HasSubstr("is older")) << "an update to the old one opens nothing";
}

TEST_F(PluginVersionsTest, APersonMaySayThatAnOlderOneRuns) {
  auto known = versions();
  EXPECT_THAT(refusal(known, 5), IsEmpty());
  EXPECT_THAT(refusal(known, 2), HasSubstr("plugins.allow_rollback"));
  options_.allow_rollback = {"turtle"};
  auto allowing = versions();
  EXPECT_THAT(refusal(allowing, 2), IsEmpty());
}

TEST_F(PluginVersionsTest, OneThatWasSignedWithoutAVersionDoesNotComeBackAfterOneWith) {
  auto known = versions();
  EXPECT_THAT(refusal(known, 0), IsEmpty()) << "as long as no version of it is known";
  EXPECT_THAT(refusal(known, 1), IsEmpty());
  EXPECT_THAT(refusal(known, 0), HasSubstr("was signed without a version"));
  EXPECT_THAT(refusal(known, 0, "other.so"), IsEmpty());
  options_.require_version = true;
  auto strict = versions();
  EXPECT_THAT(refusal(strict, 0, "other.so"), HasSubstr("iotcloud sign --version"));
}

TEST_F(PluginVersionsTest, ADamagedFileIsNotTakenForAnEmptyOne) {
  write("plugin-versions", "turtle three\n");
  EXPECT_THAT(error_of([&] { versions(); }), HasSubstr("is damaged"));
}

}  // namespace
}  // namespace iotcloud::security
