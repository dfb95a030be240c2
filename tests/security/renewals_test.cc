#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/openssl.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::security {
namespace {

using testing::HasSubstr;

class Renewals : public testing::Test {
 protected:
  /// A copy of the holder's present certificate, as a thief has it.
  std::string stolen(const std::string& holder) {
    std::string copy = folder_ / (holder + "-" + std::to_string(++copies_));
    std::filesystem::copy(made_.authority().certificate(holder), copy);
    return copy;
  }
  /// Whether one who trusts the authority and has its list takes this certificate.
  bool is_taken(const std::string& file) const {
    using namespace openssl;
    const std::unique_ptr<X509_STORE, Freed<X509_STORE_free>> store(X509_STORE_new());
    const auto authority = read_certificate(made_.authority().certificate("ca"));
    const auto certificate = read_certificate(file);
    const auto list = openssl::read_file(revocations_file(made_.authority()), [](BIO* in) {
      return RevocationList(PEM_read_bio_X509_CRL(in, nullptr, nullptr, nullptr));
    });
    X509_STORE_add_cert(store.get(), authority.get());
    X509_STORE_add_crl(store.get(), list.get());
    X509_STORE_set_flags(store.get(), X509_V_FLAG_CRL_CHECK);
    const std::unique_ptr<X509_STORE_CTX, Freed<X509_STORE_CTX_free>> check(X509_STORE_CTX_new());
    X509_STORE_CTX_init(check.get(), store.get(), certificate.get(), nullptr);
    return X509_verify_cert(check.get()) == 1;
  }

  const test::Certificates made_;
  const tests::TemporaryFolder folder_;
  int copies_ = 0;
};

TEST_F(Renewals, ARevocationIsForTheCertificatesThatWereReplacedToo) {
  const auto first = stolen("lab1");
  renew_certificate(made_.authority(), "lab1");
  const auto second = stolen("lab1");
  renew_certificate(made_.authority(), "lab1");
  renew_certificate(made_.authority(), "operator");
  EXPECT_TRUE(is_taken(first)) << "both are valid until they expire";
  revoke_certificate(made_.authority(), "lab1");
  EXPECT_FALSE(is_taken(first));
  EXPECT_FALSE(is_taken(second));
  EXPECT_FALSE(is_taken(made_.authority().certificate("lab1")));
  EXPECT_TRUE(is_taken(made_.authority().certificate("operator"))) << "another holder's";
}

TEST_F(Renewals, ARevokedHolderNeedsANewKey) {
  const auto thief = stolen("lab1");
  revoke_certificate(made_.authority(), "lab1");
  try {
    renew_certificate(made_.authority(), "lab1");
    FAIL() << "the thief's key would be certified again";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("lab1 --new-key"));
  }
  renew_certificate(made_.authority(), "lab1", usual_days, RenewedKey::new_one);
  EXPECT_TRUE(is_taken(made_.authority().certificate("lab1")));
  EXPECT_NO_THROW(TlsContext(made_.of("lab1"), TlsContext::Side::server)) << "key and certificate fit";
  EXPECT_FALSE(is_taken(thief));
}

TEST_F(Renewals, CertificatesThatHaveExpiredAreNotKept) {
  renew_certificate(made_.authority(), "lab1", -1);
  renew_certificate(made_.authority(), "lab1");  // replaces one that has expired
  renew_certificate(made_.authority(), "lab1");
  std::ifstream file(earlier_file(made_.authority()));
  int kept = 0;
  for (std::string line; std::getline(file, line);) kept += line == "-----BEGIN CERTIFICATE-----" ? 1 : 0;
  EXPECT_EQ(kept, 2) << "the first one and the third";
}

TEST_F(Renewals, ADamagedListOfEarlierCertificatesIsNotTakenForAnEmptyOne) {
  std::ofstream(earlier_file(made_.authority())) << "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
  EXPECT_THROW(renew_certificate(made_.authority(), "lab1"), config::Error);
  EXPECT_THROW(revoke_certificate(made_.authority(), "lab1"), config::Error);
}

}  // namespace
}  // namespace iotcloud::security
