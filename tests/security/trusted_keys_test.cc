// Whose signatures are trusted.
#include <atomic>

#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/eventually.h>
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

TEST_F(TrustedKeysTest, KeysThatAreRemovedCountNoLongerSoonAfterAndNewOnesDo) {
  const auto anna = new_key_pair();
  fs::create_directory(folder_ / "keys");
  const auto bens = write("ben.pub", anna.public_pem);
  write("keys/lab.pub", lab_.public_pem);
  tests::HandClock clock;
  const TrustedKeys trust({true, {folder_ / "keys", bens}}, clock);
  const auto signature = sign(anna.private_pem, "", "abc");
  EXPECT_EQ(trust.signer("abc", signature), "ben");
  const auto before = trust.generation();
  fs::remove(bens);
  fs::rename(folder_ / "keys/lab.pub", folder_ / "keys/lab.before");
  clock.advance(TrustedKeys::look_period);
  EXPECT_EQ(trust.signer("abc", signature), "");
  EXPECT_THAT(error_of([&] { trust.admit("x.so", "abc", signature_of("abc")); }), HasSubstr("by a key that"));
  const auto none = trust.generation();
  EXPECT_NE(none, before) << "earlier results of admit() are out of date";
  write("keys/anna.pub", anna.public_pem);
  clock.advance(TrustedKeys::look_period);
  EXPECT_NE(trust.generation(), none);
  EXPECT_EQ(trust.admit("x.so", "abc", signature), "anna");
  write("keys/anna.pub", lab_.public_pem);  // the folder is the same, the file in it is another one
  clock.advance(TrustedKeys::look_period);
  EXPECT_EQ(trust.signer("abc", signature), "");
  EXPECT_EQ(trust.admit("x.so", "abc", signature_of("abc")), "anna");
}

TEST_F(TrustedKeysTest, FilesAreNotLookedAtEachTime) {
  tests::HandClock clock;
  TrustedKeys trust({true, {folder_ / "lab.pub"}}, clock);
  fs::remove(folder_ / "lab.pub");
  EXPECT_EQ(trust.signer("abc", signature_of("abc")), "lab");
  trust.reload();
  EXPECT_EQ(trust.signer("abc", signature_of("abc")), "") << "unless somebody says so";
}

TEST_F(TrustedKeysTest, ThoseWhoWaitForOtherKeysAreToldSoonAfterEachChangeUntilTheyEndThat) {
  TrustedKeys trust({true, {folder_ / "lab.pub"}});
  std::atomic<int> told = 0;
  std::atomic<bool> trusted = true;
  auto watch = trust.on_change([&] {
    trusted = !trust.signer("abc", signature_of("abc")).empty();
    ++told;
  });
  fs::remove(folder_ / "lab.pub");
  EXPECT_TRUE(tests::eventually([&] { return told == 1; }));
  EXPECT_FALSE(trusted) << "the keys are asked when they are the new ones";
  write("lab.pub", lab_.public_pem);
  EXPECT_TRUE(tests::eventually([&] { return told == 2; }));
  EXPECT_TRUE(trusted);
  trust.reload();
  EXPECT_TRUE(tests::eventually([&] { return told == 3; })) << "somebody says that they may be others";
  watch = {};
  std::atomic<bool> other_told = false;
  watch = trust.on_change([&] { other_told = true; });
  trust.reload();
  EXPECT_TRUE(tests::eventually([&] { return other_told.load(); }));
  EXPECT_EQ(told, 3) << "the first one's watch has ended";
}

TEST_F(TrustedKeysTest, AKeyThatIsNoneChangesNothingAndIsSaidOnce) {
  tests::HandClock clock;
  TrustedKeys trust({true, {folder_ / "lab.pub"}}, clock);
  const auto before = trust.generation();
  const tests::CapturedLog log;
  write("lab.pub", "x");
  EXPECT_THAT(error_of([&] { trust.reload(); }), HasSubstr("lab.pub"));
  write("lab.pub", "no key");
  for (int i = 0; i < 3; ++i) {
    clock.advance(TrustedKeys::look_period);
    EXPECT_EQ(trust.admit("x.so", "abc", signature_of("abc")), "lab");
  }
  EXPECT_EQ(trust.generation(), before);
  const auto said = log.text();
  EXPECT_NE(said.find("lab.pub"), std::string::npos) << said;
  EXPECT_EQ(said.find("lab.pub"), said.rfind("lab.pub")) << "said once";
}

TEST_F(TrustedKeysTest, AKeyThatIsNoneKeepsNoRemovedOneTrusted) {
  const auto anna = new_key_pair();
  fs::create_directory(folder_ / "keys");
  write("keys/anna.pub", anna.public_pem);
  write("keys/lab.pub", lab_.public_pem);
  tests::HandClock clock;
  const TrustedKeys trust({true, {folder_ / "keys"}}, clock);
  write("keys/half.pub", "-----BEGIN PUBLIC");
  fs::remove(folder_ / "keys/lab.pub");
  clock.advance(TrustedKeys::look_period);
  EXPECT_EQ(trust.signer("abc", signature_of("abc")), "");
  EXPECT_EQ(trust.signer("abc", sign(anna.private_pem, "", "abc")), "anna");
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
