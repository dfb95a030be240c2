// That a gateway checks the bytes that a host then uses.
#include <fstream>

#include <iotcloud/gateway/fleet/plugin_source.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/security/key_folder.h>

namespace iotcloud::gateway {
namespace {

using security::error_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

class PluginSourceTest : public security::KeyFolder {
 protected:
  PluginSource source(bool required) { return PluginSource(folder_, nullptr, trust(required)); }
  static HostOrder wants(const std::string& plugin, const std::string& sha256 = "") {
    return {plugin, "gw"_gateway, false, sha256, {}};
  }
};

TEST_F(PluginSourceTest, APluginOfTheFolderIsKnownByItsBytesAndItsSigner) {
  write("turtle.so", "abc");
  auto found = source(false).find(wants("turtle.so"));
  EXPECT_EQ(found.path, folder_ / "turtle.so");
  EXPECT_EQ(found.identity, (PluginIdentity{security::sha256_hex("abc"), "", "turtle"_driver}));
  EXPECT_FALSE(found.exactly);
  write("turtle.so.sig", signature_of("abc"));
  found = source(true).find(wants("turtle.so"));
  EXPECT_EQ(found.identity, (PluginIdentity{security::sha256_hex("abc"), "lab", "turtle"_driver}));
  EXPECT_TRUE(found.exactly) << "what was checked is what the host must use";
}

TEST_F(PluginSourceTest, WithoutTheRightSignatureItIsRefusedWhereOneIsRequired) {
  auto checked = source(true);
  write("turtle.so", "abc");
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("turtle.so is not signed"));
  write("turtle.so.sig", security::sign(security::new_key_pair().private_pem, "", "abc"));
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that is trusted here"));
  write("turtle.so.sig", "short");
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that is trusted here"));
}

TEST_F(PluginSourceTest, AFolderThatIsTrustedNeedsNoSignatures) {
  PluginSource trusting(folder_, nullptr, trust(true), true);
  write("turtle.so", "abc");
  const auto found = trusting.find(wants("turtle.so"));
  EXPECT_EQ(found.identity.signed_by, "");
  EXPECT_TRUE(found.exactly);
  write("turtle.so.sig", signature_of("abc"));
  EXPECT_EQ(trusting.find(wants("turtle.so")).identity.signed_by, "lab");
}

TEST_F(PluginSourceTest, AChangeAfterACheckIsSeenAtTheNext) {
  auto checked = source(true);
  write("turtle.so", "abc");
  write("turtle.so.sig", signature_of("abc"));
  EXPECT_EQ(checked.find(wants("turtle.so")).identity.signed_by, "lab");
  EXPECT_EQ(checked.find(wants("turtle.so")).identity.signed_by, "lab");
  write("turtle.so", "abcd");
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("changed after it was signed"));
}

TEST_F(PluginSourceTest, WhatWasAdmittedIsCheckedAgainWhenTheKeysWereReadAgain) {
  const auto trusted =
      std::make_shared<security::TrustedKeys>(security::TrustedKeys::Options{true, {folder_ / "lab.pub"}});
  PluginSource checked(folder_, nullptr, trusted);
  write("turtle.so", "abc");
  write("turtle.so.sig", signature_of("abc"));
  EXPECT_EQ(checked.find(wants("turtle.so")).identity.signed_by, "lab");
  write("lab.pub", security::new_key_pair().public_pem);
  trusted->reload();
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that is trusted here"));
}

/// How many bytes this process has read so far.
std::size_t bytes_read() {
  std::string name;
  std::size_t count = 0;
  std::ifstream("/proc/self/io") >> name >> count;
  return count;
}

TEST_F(PluginSourceTest, TheDriverOfManyHostsOfOnePluginIsLookedUpOnceUntilThePluginChanges) {
  constexpr std::size_t size = 1'000'000;
  const std::string named = R"(iotcloud-plugin: driver={"name":"meter"})" + std::string(1, '\0');
  write("a.so", named + std::string(size, 'x'));
  auto asked = source(false);
  const auto before = bytes_read();
  for (int host = 0; host < 10; ++host) EXPECT_EQ(asked.driver_of(wants("a.so")), "meter"_driver);
  EXPECT_LT(bytes_read() - before, 2 * size);
  write("a.so", "another one");
  EXPECT_EQ(asked.driver_of(wants("a.so")), "a"_driver);
}

TEST_F(PluginSourceTest, AllPluginsAreListedWithWhatTheirBytesDeclareAndNoneIsLoaded) {
  const std::string mark = "iotcloud-plugin: driver=";
  write("a.so", "no library" + mark + R"({"name":"meter","version":"2"})" + std::string(1, '\0'));
  write("notes.txt", "no plugin");
  EXPECT_EQ(source(false).find(wants("a.so")).identity.driver, "meter"_driver);
  EXPECT_EQ(source(true).driver_of(wants("a.so")), "meter"_driver) << "of what runs already";
  EXPECT_TRUE(source(true).driver_of(wants("absent.so")).empty());
  const auto listed = source(false).all({});
  ASSERT_EQ(listed.size(), 1U);
  EXPECT_EQ(listed[0].file, "a.so");
  EXPECT_FALSE(listed[0].sent);
  EXPECT_EQ(listed[0].sha256.size(), 64U);
  EXPECT_GT(listed[0].size, 10);
  EXPECT_THAT(listed[0].declaration, HasSubstr(R"("driver":"meter","version":"2")"));
  const auto refused = source(true).all({});
  ASSERT_EQ(refused.size(), 1U);
  EXPECT_THAT(refused[0].problem, HasSubstr("a.so"));
}

TEST_F(PluginSourceTest, WhatIsNotThereIsNamedWithItsFolder) {
  auto checked = source(false);
  EXPECT_THAT(error_of([&] { checked.find(wants("absent.so")); }),
              AllOf(HasSubstr("absent.so"), HasSubstr(folder_.string())));
  EXPECT_THAT(error_of([&] { checked.find(wants("../x.so")); }), HasSubstr("not a plain file name"));
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so", security::sha256_hex("abc"))); }),
              HasSubstr("keeps no plugins"));
}

TEST_F(PluginSourceTest, WhatWasSentAndIsMissingIsSaidWithWhatToDo) {
  processes::PluginStore::Options kept;
  kept.folder = folder_ / "kept";
  PluginSource checked(folder_, std::make_shared<processes::PluginStore>(kept), trust(false));
  EXPECT_THAT(
      error_of([&] { checked.find(wants("turtle.so", security::sha256_hex("abc"))); }),
      AllOf(HasSubstr("turtle.so"), HasSubstr("ba7816bf8f01"), HasSubstr("iotcloud update --plugin ./turtle.so")));
}

}  // namespace
}  // namespace iotcloud::gateway
