// Whose plugins a gateway runs, and that it checks the bytes that a host then uses.
#include <iotcloud/gateway/plugins/plugin_source.h>
#include <iotcloud/tests/gateway/uploads/plugin_fixture.h>

namespace iotcloud::gateway {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

class PluginTrustTest : public PluginFolder {
 protected:
  static PluginTrust trusting(std::vector<std::string> keys, bool required = false) {
    return PluginTrust({required, std::move(keys)});
  }
};

TEST_F(PluginTrustTest, AFolderOfKeysTrustsEachOfThemByItsName) {
  const auto other = config::new_key_pair();
  fs::create_directory(folder_ / "keys");
  write("keys/anna.pub", other.public_pem);
  write("keys/lab.pem", lab_.public_pem);
  write("keys/README", "no key");
  const auto trust = trusting({folder_ / "keys"});
  EXPECT_EQ(trust.signer("abc", signature_of("abc")), "lab");
  EXPECT_EQ(trust.signer("abc", config::sign(other.private_pem, "", "abc")), "anna");
  EXPECT_EQ(trust.signer("abd", signature_of("abc")), "");
  EXPECT_EQ(trust.signer("abc", ""), "");
}

TEST_F(PluginTrustTest, AKeyThatIsNoneIsNamed) {
  EXPECT_THAT(error_of([&] { trusting({write("broken.pub", "x")}); }), HasSubstr("broken.pub"));
  EXPECT_THAT(error_of([&] { trusting({folder_ / "absent.pub"}); }), HasSubstr("absent.pub"));
  EXPECT_THAT(error_of([&] { trusting({write("secret.pub", lab_.private_pem)}); }), HasSubstr("not a public"));
}

TEST_F(PluginTrustTest, AKeyThatAnybodyMayChangeIsRefused) {
  fs::permissions(folder_ / "lab.pub", fs::perms::others_write, fs::perm_options::add);
  EXPECT_THAT(error_of([&] { trusting({folder_ / "lab.pub"}); }), AllOf(HasSubstr("lab.pub"), HasSubstr("chmod o-w")));
}

TEST_F(PluginTrustTest, RequiringSignaturesWithoutTrustingAnybodyIsRefused) {
  EXPECT_THAT(error_of([&] { trusting({}, true); }), HasSubstr("no key is trusted"));
}

TEST_F(PluginTrustTest, ReadAgainItTrustsNewKeysAndNotThoseThatAreGone) {
  const auto anna = config::new_key_pair();
  fs::create_directory(folder_ / "keys");
  const auto bens = write("ben.pub", anna.public_pem);
  write("keys/lab.pub", lab_.public_pem);
  PluginTrust trust({true, {folder_ / "keys", bens}});
  const auto signature = config::sign(anna.private_pem, "", "abc");
  EXPECT_EQ(trust.signer("abc", signature), "ben");
  fs::remove(bens);
  fs::rename(folder_ / "keys/lab.pub", folder_ / "keys/lab.before");
  EXPECT_EQ(trust.signer("abc", signature), "ben") << "not before it is told so";
  trust.reload();
  EXPECT_EQ(trust.signer("abc", signature), "");
  EXPECT_THAT(error_of([&] { trust.admit("x.so", "abc", signature_of("abc")); }), HasSubstr("by a key that"));
  write("keys/anna.pub", anna.public_pem);
  trust.reload();
  EXPECT_EQ(trust.admit("x.so", "abc", signature), "anna");
}

TEST_F(PluginTrustTest, ReadAgainAKeyThatIsNoneChangesNothing) {
  PluginTrust trust({true, {folder_ / "lab.pub"}});
  write("lab.pub", "x");
  EXPECT_THAT(error_of([&] { trust.reload(); }), HasSubstr("lab.pub"));
  EXPECT_EQ(trust.admit("x.so", "abc", signature_of("abc")), "lab");
}

class PluginSourceTest : public PluginFolder {
 protected:
  PluginSource source(bool required) { return PluginSource(folder_, nullptr, trust(required)); }
  static HostOrder wants(const std::string& plugin, const std::string& sha256 = "") {
    return {plugin, "gw", false, sha256, {}};
  }
};

TEST_F(PluginSourceTest, APluginOfTheFolderIsKnownByItsBytesAndItsSigner) {
  write("turtle.so", "abc");
  auto found = source(false).find(wants("turtle.so"));
  EXPECT_EQ(found.path, folder_ / "turtle.so");
  EXPECT_EQ(found.identity, (PluginIdentity{config::sha256_hex("abc"), ""}));
  EXPECT_FALSE(found.exactly);
  write("turtle.so.sig", signature_of("abc"));
  found = source(true).find(wants("turtle.so"));
  EXPECT_EQ(found.identity, (PluginIdentity{config::sha256_hex("abc"), "lab"}));
  EXPECT_TRUE(found.exactly) << "what was checked is what the host must use";
}

TEST_F(PluginSourceTest, WithoutTheRightSignatureItIsRefusedWhereOneIsRequired) {
  auto checked = source(true);
  write("turtle.so", "abc");
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("turtle.so is not signed"));
  write("turtle.so.sig", config::sign(config::new_key_pair().private_pem, "", "abc"));
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that this gateway trusts"));
  write("turtle.so.sig", "short");
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that this gateway trusts"));
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
  const auto trusted = std::make_shared<PluginTrust>(PluginTrust::Options{true, {folder_ / "lab.pub"}});
  PluginSource checked(folder_, nullptr, trusted);
  write("turtle.so", "abc");
  write("turtle.so.sig", signature_of("abc"));
  EXPECT_EQ(checked.find(wants("turtle.so")).identity.signed_by, "lab");
  write("lab.pub", config::new_key_pair().public_pem);
  trusted->reload();
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so")); }), HasSubstr("a key that this gateway trusts"));
}

TEST_F(PluginSourceTest, WhatIsNotThereIsNamedWithItsFolder) {
  auto checked = source(false);
  EXPECT_THAT(error_of([&] { checked.find(wants("absent.so")); }),
              AllOf(HasSubstr("absent.so"), HasSubstr(folder_.string())));
  EXPECT_THAT(error_of([&] { checked.find(wants("../x.so")); }), HasSubstr("not a plain file name"));
  EXPECT_THAT(error_of([&] { checked.find(wants("turtle.so", config::sha256_hex("abc"))); }),
              HasSubstr("keeps no plugins"));
}

}  // namespace
}  // namespace iotcloud::gateway
