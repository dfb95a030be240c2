// Whose signatures are trusted.
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/tests/security/key_folder.h>

namespace iotcloud::security {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

class TrustedKeysTest : public KeyFolder {
 protected:
  static TrustedKeys trusting(std::vector<std::string> keys, bool required = false) {
    return TrustedKeys({required, std::move(keys)});
  }
};

TEST_F(TrustedKeysTest, AFolderOfKeysTrustsEachOfThemByItsName) {
  const auto other = new_key_pair();
  fs::create_directory(folder_ / "keys");
  write("keys/anna.pub", other.public_pem);
  write("keys/lab.pem", lab_.public_pem);
  write("keys/README", "no key");
  const auto trust = trusting({folder_ / "keys"});
  EXPECT_EQ(trust.signer("abc", signature_of("abc")), "lab");
  EXPECT_EQ(trust.signer("abc", sign(other.private_pem, "", "abc")), "anna");
  EXPECT_EQ(trust.signer("abd", signature_of("abc")), "");
  EXPECT_EQ(trust.signer("abc", ""), "");
}

TEST_F(TrustedKeysTest, AKeyThatIsNoneIsNamed) {
  EXPECT_THAT(error_of([&] { trusting({write("broken.pub", "x")}); }), HasSubstr("broken.pub"));
  EXPECT_THAT(error_of([&] { trusting({folder_ / "absent.pub"}); }), HasSubstr("absent.pub"));
  EXPECT_THAT(error_of([&] { trusting({write("secret.pub", lab_.private_pem)}); }), HasSubstr("not a public"));
}

TEST_F(TrustedKeysTest, AKeyThatAnybodyMayChangeIsRefused) {
  fs::permissions(folder_ / "lab.pub", fs::perms::others_write, fs::perm_options::add);
  EXPECT_THAT(error_of([&] { trusting({folder_ / "lab.pub"}); }), AllOf(HasSubstr("lab.pub"), HasSubstr("chmod o-w")));
}

TEST_F(TrustedKeysTest, RequiringSignaturesWithoutTrustingAnybodyIsRefused) {
  EXPECT_THAT(error_of([&] { trusting({}, true); }), HasSubstr("no key is trusted"));
}

TEST_F(TrustedKeysTest, ReadAgainItTrustsNewKeysAndNotThoseThatAreGone) {
  const auto anna = new_key_pair();
  fs::create_directory(folder_ / "keys");
  const auto bens = write("ben.pub", anna.public_pem);
  write("keys/lab.pub", lab_.public_pem);
  TrustedKeys trust({true, {folder_ / "keys", bens}});
  const auto signature = sign(anna.private_pem, "", "abc");
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

TEST_F(TrustedKeysTest, ReadAgainAKeyThatIsNoneChangesNothing) {
  TrustedKeys trust({true, {folder_ / "lab.pub"}});
  write("lab.pub", "x");
  EXPECT_THAT(error_of([&] { trust.reload(); }), HasSubstr("lab.pub"));
  EXPECT_EQ(trust.admit("x.so", "abc", signature_of("abc")), "lab");
}

TEST_F(TrustedKeysTest, ASignatureWithAVersionIsOneOfItsLineToo) {
  const auto trusted = trust(true);
  const std::string good = sign_plugin(lab_.private_pem, "lab", "abc", "turtle", 7);
  EXPECT_EQ(trusted->signer("abc", good), "lab");
  EXPECT_EQ(parse_plugin_signature(good).name, "turtle");
  EXPECT_EQ(parse_plugin_signature(good).version, 7u);
  std::string newer = good;
  newer.replace(newer.find('7'), 1, "9");
  EXPECT_TRUE(is_plugin_signature(newer));
  EXPECT_EQ(trusted->signer("abc", newer), "") << "somebody made it another version";
  EXPECT_EQ(trusted->signer("abc", good.substr(good.find('\n') + 1)), "") << "somebody took the version away";
  EXPECT_EQ(trusted->signer("abcd", good), "");
  for (const char* bad : {"iotcloud-plugin turtle 0\n", "iotcloud-plugin 7\n", "iotcloud-plugin a/b 7\n",
                          "iotcloud-plugin turtle 7 8\n", "iotcloud-plugin turtle x\n", "\n"})
    EXPECT_FALSE(is_plugin_signature(bad + std::string(64, 's'))) << bad;
  EXPECT_THROW(sign_plugin(lab_.private_pem, "lab", "abc", "a b", 1), config::Error);
}

}  // namespace
}  // namespace iotcloud::security
