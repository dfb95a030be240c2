#include <filesystem>

#include <iotcloud/security/signed_object.h>
#include <iotcloud/tests/security/key_folder.h>

namespace iotcloud::security {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

class SignedObject : public KeyFolder {
 protected:
  std::string key_file(unsigned mode) const {
    const std::string file = write("lab.key", lab_.private_pem);
    std::filesystem::permissions(file, static_cast<std::filesystem::perms>(mode));
    return file;
  }
};

TEST_F(SignedObject, SaysWhoSignedItForWhichPlace) {
  const ObjectSigner key(key_file(0600));
  const std::string text = sign_object(key, "/a/b", R"({"x":"1"})");
  EXPECT_THAT(text, StartsWith(R"({"x":"1","signature":")"));
  const auto trusted = trust(true);
  EXPECT_EQ(signer_of_object(*trusted, "/a/b", text), "lab");
  EXPECT_EQ(signer_of_object(*trusted, "/a/c", text), "");
  for (std::size_t i = 0; i < text.size(); ++i) {
    std::string changed = text;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    EXPECT_EQ(signer_of_object(*trusted, "/a/b", changed), "") << changed;
    EXPECT_EQ(signer_of_object(*trusted, "/a/b", text.substr(0, i)), "");
  }
  EXPECT_EQ(signer_of_object(TrustedKeys(), "/a/b", text), "");
}

TEST_F(SignedObject, AKeyThatOthersMayReadOrThatIsNoneIsRefused) {
  EXPECT_THAT(error_of([&] { ObjectSigner{key_file(0640)}; }), HasSubstr("chmod 600"));
  EXPECT_THAT(error_of([&] { ObjectSigner{folder_ / "none.key"}; }), HasSubstr("iotcloud keys new"));
  const std::string file = write("wrong.key", "no key");
  std::filesystem::permissions(file, std::filesystem::perms::owner_read);
  EXPECT_THAT(error_of([&] { ObjectSigner{file}; }), HasSubstr("wrong.key"));
}

}  // namespace
}  // namespace iotcloud::security
