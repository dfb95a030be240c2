#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <openssl/bn.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509v3.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/private_file.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::security {

namespace {

template <auto Release>
struct Released {
  template <typename Object>
  void operator()(Object* object) const {
    Release(object);
  }
};
using OwnedBio = std::unique_ptr<BIO, Released<BIO_free_all>>;
using OwnedX509 = std::unique_ptr<X509, Released<X509_free>>;
using OwnedKey = std::unique_ptr<EVP_PKEY, Released<EVP_PKEY_free>>;
using OwnedList = std::unique_ptr<X509_CRL, Released<X509_CRL_free>>;

constexpr long seconds_of_a_day = 24L * 60 * 60;
constexpr long list_days = 3650;  ///< as long as the authority
constexpr int bits_of_serial = 127;
constexpr long slow_clock_s = 60L * 60;  ///< as in certificates.cc

void must_succeed(bool good, const std::string& what) {
  if (!good) throw config::Error(fmt::format("OpenSSL cannot {}: {}", what, tls_error()));
}

template <typename Read>
auto read_pem(const std::string& file, Read&& read) {
  const OwnedBio in(BIO_new_file(file.c_str(), "r"));
  auto object = in ? read(in.get()) : decltype(read(in.get())){};
  if (!object) throw config::Error(fmt::format("{} cannot be read: {}", file, tls_error()));
  return object;
}

OwnedX509 read_x509(const std::string& file) {
  return read_pem(file, [](BIO* in) { return OwnedX509(PEM_read_bio_X509(in, nullptr, nullptr, nullptr)); });
}

OwnedKey read_authority_key(const Authority& authority) {
  return read_pem(authority.key("ca"),
                  [](BIO* in) { return OwnedKey(PEM_read_bio_PrivateKey(in, nullptr, nullptr, nullptr)); });
}

/// Reads a holder's certificate. \throws Error if another authority made it
OwnedX509 read_issued(const Authority& authority, const std::string& holder, X509* issuer) {
  auto certificate = read_x509(authority.certificate(holder));
  if (X509_verify(certificate.get(), X509_get0_pubkey(issuer)) != 1)
    throw config::Error(fmt::format("{} is not of this authority", authority.certificate(holder)));
  return certificate;
}

std::string pem_text(BIO* memory) {
  char* data = nullptr;
  const auto size = BIO_get_mem_data(memory, &data);
  return {data, static_cast<std::size_t>(size)};
}

void sign_and_write(const Authority& authority, X509_CRL* list) {
  const auto issuer = read_x509(authority.certificate("ca"));
  const auto key = read_authority_key(authority);
  const std::unique_ptr<ASN1_TIME, Released<ASN1_TIME_free>> time(ASN1_TIME_new());
  must_succeed(X509_CRL_set_version(list, X509_CRL_VERSION_2) == 1 &&
                   X509_CRL_set_issuer_name(list, X509_get_subject_name(issuer.get())) == 1 &&
                   X509_gmtime_adj(time.get(), -slow_clock_s) != nullptr &&
                   X509_CRL_set1_lastUpdate(list, time.get()) == 1 &&
                   X509_gmtime_adj(time.get(), list_days * seconds_of_a_day) != nullptr &&
                   X509_CRL_set1_nextUpdate(list, time.get()) == 1 && X509_CRL_sort(list) == 1 &&
                   X509_CRL_sign(list, key.get(), EVP_sha256()) > 0,
               "sign a list of revoked certificates");
  const OwnedBio memory(BIO_new(BIO_s_mem()));
  must_succeed(PEM_write_bio_X509_CRL(memory.get(), list) == 1, "write a list of revoked certificates");
  config::replace_file(revocations_file(authority), pem_text(memory.get()), for_readers);
}

}  // namespace

void renew_certificate(const Authority& authority, const std::string& holder, int days) {
  const auto issuer = read_x509(authority.certificate("ca"));
  const auto key = read_authority_key(authority);
  const auto before = read_issued(authority, holder, issuer.get());
  const OwnedX509 renewed(X509_dup(before.get()));
  const std::unique_ptr<BIGNUM, Released<BN_free>> serial(BN_new());
  must_succeed(renewed && serial && BN_rand(serial.get(), bits_of_serial, BN_RAND_TOP_ANY, BN_RAND_BOTTOM_ANY) == 1 &&
                   BN_to_ASN1_INTEGER(serial.get(), X509_get_serialNumber(renewed.get())) != nullptr &&
                   X509_gmtime_adj(X509_getm_notBefore(renewed.get()), -slow_clock_s) != nullptr &&
                   X509_gmtime_adj(X509_getm_notAfter(renewed.get()), days * seconds_of_a_day) != nullptr &&
                   X509_sign(renewed.get(), key.get(), EVP_sha256()) > 0,
               "renew a certificate");
  const OwnedBio memory(BIO_new(BIO_s_mem()));
  must_succeed(PEM_write_bio_X509(memory.get(), renewed.get()) == 1, "write a certificate");
  config::replace_file(authority.certificate(holder), pem_text(memory.get()), for_readers);
}

std::string revocations_file(const Authority& authority) {
  return authority.folder + "/revoked.pem";
}

void make_revocations(const Authority& authority) {
  if (std::filesystem::exists(revocations_file(authority))) return;
  const OwnedList list(X509_CRL_new());
  must_succeed(list != nullptr, "make a list of revoked certificates");
  sign_and_write(authority, list.get());
}

void revoke_certificate(const Authority& authority, const std::string& holder) {
  make_revocations(authority);
  const auto issuer = read_x509(authority.certificate("ca"));
  const auto certificate = read_issued(authority, holder, issuer.get());
  const auto list = read_pem(revocations_file(authority),
                             [](BIO* in) { return OwnedList(PEM_read_bio_X509_CRL(in, nullptr, nullptr, nullptr)); });
  X509_REVOKED* known = nullptr;
  if (X509_CRL_get0_by_cert(list.get(), &known, certificate.get()) == 1) return;
  std::unique_ptr<X509_REVOKED, Released<X509_REVOKED_free>> revoked(X509_REVOKED_new());
  const std::unique_ptr<ASN1_TIME, Released<ASN1_TIME_free>> now(ASN1_TIME_new());
  must_succeed(revoked && X509_gmtime_adj(now.get(), 0) != nullptr &&
                   X509_REVOKED_set_serialNumber(revoked.get(), X509_get_serialNumber(certificate.get())) == 1 &&
                   X509_REVOKED_set_revocationDate(revoked.get(), now.get()) == 1 &&
                   X509_CRL_add0_revoked(list.get(), revoked.get()) == 1,
               "revoke a certificate");
  static_cast<void>(revoked.release());  // the list owns it
  sign_and_write(authority, list.get());
}

double days_left(const std::string& file) {
  const auto certificate = read_x509(file);
  int days = 0;
  int seconds = 0;
  must_succeed(ASN1_TIME_diff(&days, &seconds, nullptr, X509_get0_notAfter(certificate.get())) == 1, "read a date");
  return days + static_cast<double>(seconds) / seconds_of_a_day;
}

}  // namespace iotcloud::security
