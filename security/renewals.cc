#include <filesystem>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/pemerr.h>

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

/// The certificates that renewals replaced, without those that have expired.
std::vector<Certificate> read_earlier(const Authority& authority) {
  std::vector<Certificate> found;
  const std::string file = earlier_file(authority);
  if (!std::filesystem::exists(file)) return found;
  const Memory in(BIO_new_file(file.c_str(), "r"));
  must(in != nullptr, "read the earlier certificates");
  while (Certificate next{PEM_read_bio_X509(in.get(), nullptr, nullptr, nullptr)}) {
    if (X509_cmp_current_time(X509_get0_notAfter(next.get())) > 0) found.push_back(std::move(next));
  }
  // The end of the file is an error, too, for OpenSSL.
  const auto end = ERR_GET_REASON(ERR_peek_last_error());
  ERR_clear_error();
  if (end != PEM_R_NO_START_LINE) {
    throw config::Error(
        fmt::format("{} is damaged: it must hold certificates (PEM), those that `certs renew` replaced; "
                    "put it back from a backup, since without it they cannot be revoked",
                    file));
  }
  return found;
}

void keep(const Authority& authority, X509* replaced) {
  std::string text = pem_of(replaced);
  for (const auto& certificate : read_earlier(authority)) text += pem_of(certificate.get());
  config::replace_file(earlier_file(authority), text, for_readers);
}

RevocationList read_revocations(const Authority& authority) {
  return read_file(revocations_file(authority),
                   [](BIO* in) { return RevocationList(PEM_read_bio_X509_CRL(in, nullptr, nullptr, nullptr)); });
}

bool is_on(X509_CRL* list, X509* certificate) {
  X509_REVOKED* known = nullptr;
  return X509_CRL_get0_by_cert(list, &known, certificate) == 1;
}

void put_on(X509_CRL* list, X509* certificate) {
  if (is_on(list, certificate)) return;
  std::unique_ptr<X509_REVOKED, Freed<X509_REVOKED_free>> revoked(X509_REVOKED_new());
  const std::unique_ptr<ASN1_TIME, Freed<ASN1_TIME_free>> now(ASN1_TIME_new());
  must(revoked && X509_gmtime_adj(now.get(), 0) != nullptr &&
           X509_REVOKED_set_serialNumber(revoked.get(), X509_get_serialNumber(certificate)) == 1 &&
           X509_REVOKED_set_revocationDate(revoked.get(), now.get()) == 1 &&
           X509_CRL_add0_revoked(list, revoked.get()) == 1,
       "revoke a certificate");
  static_cast<void>(revoked.release());  // the list owns it
}

/// Says whose key signs the list, so that it is told from that of another authority of the same name.
void name_key(X509_CRL* list, X509* issuer) {
  if (X509_CRL_get_ext_by_NID(list, NID_authority_key_identifier, -1) >= 0) return;
  X509V3_CTX context;
  X509V3_set_ctx_nodb(&context);
  X509V3_set_ctx(&context, issuer, nullptr, nullptr, list, 0);
  const std::unique_ptr<X509_EXTENSION, Freed<X509_EXTENSION_free>> key(
      X509V3_EXT_conf_nid(nullptr, &context, NID_authority_key_identifier, "keyid"));
  must(key && X509_CRL_add_ext(list, key.get(), -1) == 1, "name the key of a list of revoked certificates");
}

void sign_and_write(const Authority& authority, X509_CRL* list) {
  const auto issuer = read_certificate(authority.certificate("ca"));
  name_key(list, issuer.get());
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

void renew_certificate(const Authority& authority, const std::string& holder, int days, RenewedKey key) {
  const auto issuer = read_certificate(authority.certificate("ca"));
  const auto signer = read_key(authority.key("ca"));
  const auto before = read_issued(authority, holder, issuer.get());
  make_revocations(authority);
  if (key == RenewedKey::same && is_on(read_revocations(authority).get(), before.get())) {
    throw config::Error(
        fmt::format("{} is revoked, and a certificate for the same key would serve whoever stole that key: give its "
                    "holder a new one (iotcloud certs renew {} {} --new-key)",
                    authority.certificate(holder), authority.folder, holder));
  }
  const Certificate renewed(X509_dup(before.get()));
  must(renewed != nullptr, "renew a certificate");
  date_and_number(renewed.get(), days);
  Key fresh;
  if (key == RenewedKey::new_one) {
    fresh = make_key();
    must(X509_set_pubkey(renewed.get(), fresh.get()) == 1, "put a key into a certificate");
  }
  must(X509_sign(renewed.get(), signer.get(), EVP_sha256()) > 0, "sign a certificate");
  keep(authority, before.get());
  if (fresh) config::replace_file(authority.key(holder), pem_of(fresh.get()), for_owner);
  config::replace_file(authority.certificate(holder), pem_of(renewed.get()), for_readers);
}

std::string earlier_file(const Authority& authority) {
  return authority.folder + "/earlier-certificates";
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
  const auto list = read_revocations(authority);
  put_on(list.get(), certificate.get());
  for (const auto& earlier : read_earlier(authority)) {
    if (X509_NAME_cmp(X509_get_subject_name(earlier.get()), X509_get_subject_name(certificate.get())) == 0)
      put_on(list.get(), earlier.get());
  }
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
