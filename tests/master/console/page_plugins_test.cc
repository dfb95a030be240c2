#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/console/page_plugins.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::master {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

const std::string good_page = R"(// iotcloud page: {"title": "The robot", "driver": "turtle"}
document.title = "x";
)";

class PagePluginsTest : public testing::Test {
 protected:
  PagePluginsTest() {
    std::filesystem::create_directory(folder_ / "pages");
    write("lab.pub", keys_.public_pem);
  }
  void write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
  }
  void write_page(const std::string& name, const std::string& text) const { write("pages/" + name, text); }
  void sign(const std::string& name, const std::string& text) const {
    write_page(name + ".sig", security::sign(keys_.private_pem, "the test", text));
  }
  void sign(const std::string& name, const std::string& text, std::uint64_t version) const {
    write_page(name + ".sig", security::sign_plugin(keys_.private_pem, "the test", text, "robot", version));
  }
  PagePlugins pages(bool signed_only) const {
    security::TrustedKeys::Options options{signed_only, {folder_ / "lab.pub"}};
    return PagePlugins({{folder_ / "pages"}, std::make_shared<security::TrustedKeys>(options)});
  }
  /// Pages of a master that remembers their versions, as it does after a restart.
  PagePlugins remembered() const {
    security::PluginVersions::Options options;
    options.file = folder_ / "page-versions";
    options.keys = "console.pages";
    return PagePlugins(
        {{folder_ / "pages"},
         std::make_shared<security::TrustedKeys>(security::TrustedKeys::Options{true, {folder_ / "lab.pub"}}),
         std::make_shared<security::PluginVersions>(options)});
  }
  static std::string problem_of(const PagePlugins& pages, const std::string& name) {
    try {
      return pages.document(name).html.empty() ? "nothing" : "";
    } catch (const config::Error& error) {
      return error.what();
    }
  }

  const tests::TemporaryFolder folder_;
  const security::KeyPair keys_ = security::new_key_pair();
};

TEST_F(PagePluginsTest, AreListedWithTheirTitleDriverAndSigner) {
  write_page("turtlebot.js", good_page);
  sign("turtlebot.js", good_page);
  write_page("notes.txt", "no page");
  write_page("a name with spaces.js", good_page);
  const auto list = pages(true).list();
  ASSERT_EQ(list.size(), 1u);
  EXPECT_EQ(list[0].name, "turtlebot");
  EXPECT_EQ(list[0].title, "The robot");
  EXPECT_EQ(list[0].driver, "turtle");
  EXPECT_EQ(list[0].signed_by, "lab");
  EXPECT_EQ(list[0].problem, "");
}

TEST_F(PagePluginsTest, RunOnlyTheirOwnScriptWithoutANetworkInAnOriginOfTheirOwn) {
  write_page("turtlebot.js", good_page);
  const auto document = pages(false).document("turtlebot");
  EXPECT_THAT(document.html, HasSubstr("<script>" + good_page + "</script>"));
  EXPECT_THAT(document.policy, AllOf(HasSubstr("default-src 'none'; script-src 'sha256-"),
                                     HasSubstr("sandbox allow-scripts"), HasSubstr("frame-ancestors 'self'"),
                                     Not(HasSubstr("allow-same-origin")), Not(HasSubstr("connect-src"))));
  write_page("empty-lines.js", good_page + "\r\n\r\n");
  EXPECT_THAT(pages(false).document("empty-lines").html, Not(HasSubstr("\r")));
}

TEST_F(PagePluginsTest, WithoutATrustedSignatureAreRefusedWhereOneIsNeeded) {
  write_page("unsigned.js", good_page);
  write_page("changed.js", good_page + "stolen();");
  sign("changed.js", good_page);
  write_page("stranger.js", good_page);
  write_page("stranger.js.sig", security::sign(security::new_key_pair().private_pem, "a stranger", good_page));
  const auto strict = pages(true);
  EXPECT_THAT(problem_of(strict, "unsigned"),
              AllOf(HasSubstr("unsigned.js is not signed"), HasSubstr("iotcloud sign")));
  EXPECT_THAT(problem_of(strict, "changed"), HasSubstr("changed after it was signed"));
  EXPECT_THAT(problem_of(strict, "stranger"), HasSubstr("trusted_keys"));
  for (const auto& page : strict.list()) {
    EXPECT_NE(page.problem, "") << page.name;
    EXPECT_EQ(page.driver, "") << "what an unsigned page says of itself is not read";
  }
  const auto open = pages(false);
  for (const char* const name : {"unsigned", "changed", "stranger"}) EXPECT_EQ(problem_of(open, name), "") << name;
}

TEST_F(PagePluginsTest, ThatAreReplacedCountAtOnce) {
  const auto strict = pages(true);
  EXPECT_THAT(problem_of(strict, "late"), HasSubstr("there is no page \"late\""));
  write_page("late.js", good_page);
  EXPECT_NE(problem_of(strict, "late"), "");
  sign("late.js", good_page);
  EXPECT_EQ(problem_of(strict, "late"), "");
}

TEST_F(PagePluginsTest, OfAnOlderVersionThanOneThatWasShownAreNotShownAlsoUnderAnotherNameAndAfterARestart) {
  const std::string newer = good_page + "newer();";
  write_page("robot.js", good_page);
  sign("robot.js", good_page, 1);
  EXPECT_EQ(problem_of(remembered(), "robot"), "");
  write_page("robot.js", newer);
  sign("robot.js", newer, 2);
  EXPECT_EQ(problem_of(remembered(), "robot"), "");
  const auto again = remembered();
  for (const std::string name : {"robot", "other"}) {
    write_page(name + ".js", good_page);
    sign(name + ".js", good_page, 1);
    EXPECT_THAT(problem_of(again, name), AllOf(HasSubstr("version 1 of robot is older than version 2"),
                                               HasSubstr("console.pages.allow_rollback")))
        << name;
  }
  for (const auto& page : again.list()) EXPECT_EQ(page.driver, "") << "what it says of itself is not read";
  sign("robot.js", good_page);
  EXPECT_THAT(problem_of(again, "robot"), HasSubstr("signed without a version"));
  EXPECT_EQ(problem_of(pages(true), "other"), "") << "without a memory any signed version is shown";
}

TEST_F(PagePluginsTest, ThatAreNoneAreRefusedWithTheReason) {
  write_page("headless.js", "alert(1)");
  write_page("driverless.js", "// iotcloud page: {\"title\": \"x\"}\n");
  write_page("list.js", "// iotcloud page: [1]\n");
  write_page("broken.js", "// iotcloud page: {\"title\n");
  write_page("leaving.js", good_page + "'</ScRipt><script>'");
  write_page("large.js", good_page + std::string(std::size_t{1} << 20U, ' '));
  const auto open = pages(false);
  EXPECT_THAT(problem_of(open, "headless"), HasSubstr("its first line is to be: // iotcloud page: "));
  EXPECT_THAT(problem_of(open, "driverless"), HasSubstr("no text \"driver\""));
  EXPECT_THAT(problem_of(open, "list"), HasSubstr("no object"));
  EXPECT_THAT(problem_of(open, "broken"), HasSubstr("the first line"));
  EXPECT_THAT(problem_of(open, "leaving"), HasSubstr("</script"));
  EXPECT_THAT(problem_of(open, "large"), HasSubstr("1048576 bytes"));
  for (const char* const name : {"..", "../lab", "a/b", "", "large.js"})
    EXPECT_THAT(problem_of(open, name), HasSubstr("there is no page")) << name;
}

}  // namespace
}  // namespace iotcloud::master
