#include <filesystem>
#include <memory>

#include <fmt/format.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/openssl.h>
#include <iotcloud/security/private_file.h>
#include <iotcloud/security/renewals.h>

namespace iotcloud::security {

namespace {

using namespace openssl;

/// Reads a holder's certificate. \throws Error if another authority made it
Certificate read_issued(const Authority& authority, const std::string& holder, X509* issuer) {
  auto certificate = read_certificate(authority.certificate(holder));
  if (X509_verify(certificate.get(), X509_get0_pubkey(issuer)) != 1)
    throw config::Error(fmt::format("{} is not of this authority", authority.certificate(holder)));
  return certificate;
}

void sign_and_write(const Authority& authority, X509_CRL* list) {
  const auto issuer = read_certificate(authority.certificate("ca"));
  const auto key = read_key(authority.key("ca"));
  const std::unique_ptr<ASN1_TIME, Freed<ASN1_TIME_free>> time(ASN1_TIME_new());
  must(X509_CRL_set_version(list, X509_CRL_VERSION_2) == 1 &&
           X509_CRL_set_issuer_name(list, X509_get_subject_name(issuer.get())) == 1 &&
           X509_gmtime_adj(time.get(), -clock_error_s) != nullptr && X509_CRL_set1_lastUpdate(list, time.get()) == 1 &&
           X509_gmtime_adj(time.get(), authority_days * day_s) != nullptr &&
           X509_CRL_set1_nextUpdate(list, time.get()) == 1 && X509_CRL_sort(list) == 1 &&
           X509_CRL_sign(list, key.get(), EVP_sha256()) > 0,
       "sign a list of revoked certificates");
  const Memory memory(BIO_new(BIO_s_mem()));
  must(PEM_write_bio_X509_CRL(memory.get(), list) == 1, "write a list of revoked certificates");
  config::replace_file(revocations_file(authority), written_to(memory.get()), for_readers);
}

}  // namespace

void renew_certificate(const Authority& authority, const std::string& holder, int days) {
  const auto issuer = read_certificate(authority.certificate("ca"));
  const auto key = read_key(authority.key("ca"));
  const auto before = read_issued(authority, holder, issuer.get());
  const Certificate renewed(X509_dup(before.get()));
  must(renewed != nullptr, "renew a certificate");
  date_and_number(renewed.get(), days);
  must(X509_sign(renewed.get(), key.get(), EVP_sha256()) > 0, "sign a certificate");
  config::replace_file(authority.certificate(holder), pem_of(renewed.get()), for_readers);
}

std::string revocations_file(const Authority& authority) {
  return authority.folder + "/revoked.pem";
}

void make_revocations(const Authority& authority) {
  if (std::filesystem::exists(revocations_file(authority))) return;
  const RevocationList list(X509_CRL_new());
  must(list != nullptr, "make a list of revoked certificates");
  sign_and_write(authority, list.get());
}

void revoke_certificate(const Authority& authority, const std::string& holder) {
  make_revocations(authority);
  const auto issuer = read_certificate(authority.certificate("ca"));
  const auto certificate = read_issued(authority, holder, issuer.get());
  const auto list = read_file(revocations_file(authority), [](BIO* in) {
    return RevocationList(PEM_read_bio_X509_CRL(in, nullptr, nullptr, nullptr));
  });
  X509_REVOKED* known = nullptr;
  if (X509_CRL_get0_by_cert(list.get(), &known, certificate.get()) == 1) return;
  std::unique_ptr<X509_REVOKED, Freed<X509_REVOKED_free>> revoked(X509_REVOKED_new());
  const std::unique_ptr<ASN1_TIME, Freed<ASN1_TIME_free>> now(ASN1_TIME_new());
  must(revoked && X509_gmtime_adj(now.get(), 0) != nullptr &&
           X509_REVOKED_set_serialNumber(revoked.get(), X509_get_serialNumber(certificate.get())) == 1 &&
           X509_REVOKED_set_revocationDate(revoked.get(), now.get()) == 1 &&
           X509_CRL_add0_revoked(list.get(), revoked.get()) == 1,
       "revoke a certificate");
  static_cast<void>(revoked.release());  // the list owns it
  sign_and_write(authority, list.get());
}

double days_left(const std::string& file) {
  const auto certificate = read_certificate(file);
  int days = 0;
  int seconds = 0;
  must(ASN1_TIME_diff(&days, &seconds, nullptr, X509_get0_notAfter(certificate.get())) == 1, "read a date");
  return days + static_cast<double>(seconds) / day_s;
}

}  // namespace iotcloud::security
