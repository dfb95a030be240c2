#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::security {
namespace {

using ::testing::HasSubstr;

std::string bytes_of(const std::string& hex) {
  std::string bytes;
  for (std::size_t i = 0; i < hex.size(); i += 2) bytes += static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16));
  return bytes;
}

std::string error_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

TEST(Sha256, GivesTheKnownDigests) {
  EXPECT_EQ(sha256_hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  Sha256 pieces;
  pieces.add("a");
  pieces.add("");
  pieces.add("bc");
  EXPECT_EQ(pieces.hex(), sha256_hex("abc"));
}

TEST(Sha256, OnlyItsOwnSpellingIsOne) {
  EXPECT_TRUE(is_sha256(sha256_hex("")));
  for (const std::string text : {"", "abc", "../../../../../../../../../../../../../../../../../../../../../.",
                                 "E3B0C44298FC1C149AFBF4C8996FB92427AE41E4649B934CA495991B7852B855"}) {
    EXPECT_FALSE(is_sha256(text)) << text;
  }
  EXPECT_EQ(short_sha256(sha256_hex("abc")), "ba7816bf8f01");
}

/// RFC 8032, section 7.1, test 2: the secret and the public key of that test as PEM, its message and its signature.
constexpr const char* rfc_private = R"(-----BEGIN PRIVATE KEY-----
MC4CAQAwBQYDK2VwBCIEIEzNCJso/5banbbDRuwRTg9bijGfNaumJNqM9u1PuKb7
-----END PRIVATE KEY-----
)";
constexpr const char* rfc_public = R"(-----BEGIN PUBLIC KEY-----
MCowBQYDK2VwAyEAPUAXw+hDiVqStwqnTRt+vJyYLM8uxJaMwM1V8Sr0Zgw=
-----END PUBLIC KEY-----
)";
const std::string rfc_message = "\x72";
const std::string rfc_signature = bytes_of(
    "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da"
    "085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00");

TEST(Ed25519, SignsAndVerifiesTheVectorOfRfc8032) {
  EXPECT_EQ(sign(rfc_private, "rfc", rfc_message), rfc_signature);
  EXPECT_TRUE(PublicKey::from_pem(rfc_public, "rfc").verifies(rfc_message, rfc_signature));
}

TEST(Ed25519, OneBitMoreOrLessIsNoSignature) {
  const auto key = PublicKey::from_pem(rfc_public, "rfc");
  for (std::size_t i = 0; i < rfc_signature.size(); ++i) {
    auto changed = rfc_signature;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    EXPECT_FALSE(key.verifies(rfc_message, changed)) << i;
  }
  EXPECT_FALSE(key.verifies("\x73", rfc_signature));
  EXPECT_FALSE(key.verifies("", rfc_signature));
  EXPECT_FALSE(key.verifies(rfc_message, ""));
  EXPECT_FALSE(key.verifies(rfc_message, rfc_signature.substr(1)));
  EXPECT_FALSE(key.verifies(rfc_message, rfc_signature + "x"));
}

TEST(Ed25519, ANewPairBelongsTogetherAndToNoOther) {
  const auto mine = new_key_pair(), another = new_key_pair();
  EXPECT_NE(mine.private_pem, another.private_pem);
  const auto signature = sign(mine.private_pem, "mine", "a plugin");
  EXPECT_TRUE(PublicKey::from_pem(mine.public_pem, "mine").verifies("a plugin", signature));
  EXPECT_FALSE(PublicKey::from_pem(another.public_pem, "another").verifies("a plugin", signature));
}

TEST(Ed25519, WhatIsNoKeyOfTheRightKindIsRefusedByItsName) {
  const auto pair = new_key_pair();
  // A public key on the curve X25519, which cannot sign.
  const std::string other_curve =
      "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VuAyEAPUAXw+hDiVqStwqnTRt+vJyYLM8uxJaMwM1V8Sr0Zgw=\n-----END PUBLIC "
      "KEY-----\n";
  for (const std::string& pem : {std::string(), std::string("no PEM"), pair.private_pem, other_curve}) {
    EXPECT_THAT(error_of([&] { PublicKey::from_pem(pem, "lab.pub"); }), HasSubstr("lab.pub: not a public Ed25519 key"));
  }
  EXPECT_THAT(error_of([&] { sign(pair.public_pem, "lab.key", "x"); }),
              HasSubstr("lab.key: not a private Ed25519 key"));
}

}  // namespace
}  // namespace iotcloud::security
