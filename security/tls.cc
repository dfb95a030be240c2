#include <algorithm>
#include <array>
#include <memory>

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/pemerr.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::security {

std::string tls_error() {
  const unsigned long code = ERR_get_error();  // the first error: later ones follow from it
  ERR_clear_error();
  if (code == 0) return "unknown error";
  if (const char* reason = ERR_reason_error_string(code)) return reason;
  std::array<char, 256> text{};
  ERR_error_string_n(code, text.data(), text.size());
  return text.data();
}

void expect_host(ssl_st* ssl, const std::string& host) {
  if (config::is_address(host)) {
    X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(ssl), host.c_str());
    return;
  }
  SSL_set_hostflags(ssl, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
  SSL_set1_host(ssl, host.c_str());
  SSL_ctrl(ssl, SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name, const_cast<char*>(host.c_str()));
}

namespace {

using HeldCertificate = std::unique_ptr<X509, decltype(&X509_free)>;

std::string subject_of(const X509* certificate) {
  const std::unique_ptr<BIO, decltype(&BIO_free)> text(BIO_new(BIO_s_mem()), BIO_free);
  X509_NAME_print_ex(text.get(), X509_get_subject_name(certificate), 0, XN_FLAG_RFC2253 & ~ASN1_STRFLGS_ESC_MSB);
  char* data = nullptr;
  const auto size = BIO_get_mem_data(text.get(), &data);
  return {data, static_cast<std::size_t>(size)};
}

std::string text_of(const ASN1_STRING* text) {
  return {reinterpret_cast<const char*>(ASN1_STRING_get0_data(text)),
          static_cast<std::size_t>(ASN1_STRING_length(text))};
}

/// Whether the certificate has exactly one common name, and it is this.
bool is_common_name(const X509* certificate, const std::string& name) {
  const X509_NAME* const subject = X509_get_subject_name(certificate);
  const int at = X509_NAME_get_index_by_NID(subject, NID_commonName, -1);
  if (at < 0 || X509_NAME_get_index_by_NID(subject, NID_commonName, at) >= 0) return false;
  return text_of(X509_NAME_ENTRY_get_data(X509_NAME_get_entry(subject, at))) == name;
}

bool has_uri(const X509* certificate, const std::string& uri) {
  const std::unique_ptr<GENERAL_NAMES, decltype(&GENERAL_NAMES_free)> names(
      static_cast<GENERAL_NAMES*>(X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)),
      GENERAL_NAMES_free);
  for (int i = 0; names && i < sk_GENERAL_NAME_num(names.get()); ++i) {
    const GENERAL_NAME* const name = sk_GENERAL_NAME_value(names.get(), i);
    if (name->type == GEN_URI && text_of(name->d.uniformResourceIdentifier) == uri) return true;
  }
  return false;
}

}  // namespace

std::string peer_subject(const ssl_st* ssl) {
  const HeldCertificate certificate(SSL_get1_peer_certificate(ssl), X509_free);
  return certificate ? subject_of(certificate.get()) : "";
}

ShownCertificate shown_certificate(const ssl_st* ssl) {
  ShownCertificate shown;
  shown.own = {SSL_get1_peer_certificate(ssl), X509_free};
  if (!shown.own) return shown;
  if (STACK_OF(X509)* const chain = SSL_get_peer_cert_chain(ssl))
    shown.between = {X509_chain_up_ref(chain), [](STACK_OF(X509) * all) { sk_X509_pop_free(all, X509_free); }};
  SSL_CTX* const context = SSL_get_SSL_CTX(ssl);
  SSL_CTX_up_ref(context);
  shown.checked_by = {context, SSL_CTX_free};
  return shown;
}

std::string to_string(NamedDaemon::Kind kind) {
  return kind == NamedDaemon::Kind::gateway ? "gateway" : "pool";
}

std::string uri_of(const NamedDaemon& daemon) {
  return "urn:iotcloud:" + to_string(daemon.kind) + ":" + daemon.id;
}

bool is_peer(const ssl_st* ssl, const NamedDaemon& daemon) {
  const HeldCertificate certificate(SSL_get1_peer_certificate(ssl), X509_free);
  return certificate && (is_common_name(certificate.get(), daemon.id) || has_uri(certificate.get(), uri_of(daemon)));
}

std::string subject_in(const std::string& file) {
  const std::unique_ptr<BIO, decltype(&BIO_free_all)> in(BIO_new_file(file.c_str(), "r"), BIO_free_all);
  const HeldCertificate certificate(in ? PEM_read_bio_X509(in.get(), nullptr, nullptr, nullptr) : nullptr, X509_free);
  if (!certificate) throw config::Error(fmt::format("{} is no certificate that can be read: {}", file, tls_error()));
  return subject_of(certificate.get());
}

TlsFiles read_tls(config::YamlSection& section) {
  auto tls = section.optional_section("tls");
  if (!tls) return {};
  TlsFiles files;
  files.ca = tls->require_string("ca");
  files.certificate = tls->require_string("certificate");
  files.key = tls->require_string("key");
  files.revoked = tls->string_or("revoked", "");
  tls->finish();
  if (!section.runs_here()) return files;
  try {
    const TlsContext tried(files, TlsContext::Side::server);
  } catch (const config::Error& e) {
    section.refuse("tls", e.what(), "`iotcloud certs init` makes such files");
  }
  return files;
}

namespace {

/// OpenSSL would ask for a key's password at the terminal, which a daemon does not have.
int no_password(char*, int, int, void*) {
  return 0;
}

}  // namespace

TlsContext::TlsContext(const TlsFiles& files, Side side)
    : context_(SSL_CTX_new(side == Side::client ? TLS_client_method() : TLS_server_method())), side_(side) {
  const std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)> owned(context_, SSL_CTX_free);
  const auto must = [](bool done, const char* what, const std::string& file) {
    if (!done) throw config::Error(fmt::format("{} {} cannot be used: {}", what, file, tls_error()));
  };
  ERR_clear_error();
  must(context_ != nullptr, "TLS", "");
  must(SSL_CTX_set_min_proto_version(context_, TLS1_2_VERSION) == 1, "TLS 1.2", "");
  SSL_CTX_set_options(context_, SSL_OP_NO_TICKET | SSL_OP_NO_RENEGOTIATION | SSL_OP_NO_COMPRESSION);
  SSL_CTX_set_session_cache_mode(context_, SSL_SESS_CACHE_OFF);
  SSL_CTX_set_num_tickets(context_, 0);
  SSL_CTX_set_mode(context_, SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  SSL_CTX_set_default_passwd_cb(context_, no_password);
  SSL_CTX_set_verify(context_, side == Side::site ? SSL_VERIFY_PEER : SSL_VERIFY_PEER | SSL_VERIFY_FAIL_IF_NO_PEER_CERT,
                     nullptr);
  must(SSL_CTX_load_verify_locations(context_, files.ca.c_str(), nullptr) == 1, "the authorities' file", files.ca);
  if (side != Side::client) SSL_CTX_set_client_CA_list(context_, SSL_load_client_CA_file(files.ca.c_str()));
  must(SSL_CTX_use_certificate_chain_file(context_, files.certificate.c_str()) == 1, "the certificate",
       files.certificate);
  must(SSL_CTX_use_PrivateKey_file(context_, files.key.c_str(), SSL_FILETYPE_PEM) == 1, "the private key", files.key);
  must(SSL_CTX_check_private_key(context_) == 1, "the private key", files.key);
  if (!files.revoked.empty()) load_revocations(files.revoked);
  SSL_CTX_up_ref(context_);  // a reference for the destructor to release
}

void TlsContext::load_revocations(const std::string& file) {
  const std::unique_ptr<BIO, decltype(&BIO_free_all)> in(BIO_new_file(file.c_str(), "r"), BIO_free_all);
  X509_STORE* const store = SSL_CTX_get_cert_store(context_);
  bool good = in != nullptr;
  while (good) {
    const std::shared_ptr<X509_CRL> list(PEM_read_bio_X509_CRL(in.get(), nullptr, nullptr, nullptr), X509_CRL_free);
    if (!list) break;
    good = X509_STORE_add_crl(store, list.get()) == 1;
    revocations_.push_back(list);
  }
  // The end of the file is an error, too, for OpenSSL.
  const bool whole = good && !revocations_.empty() && ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  if (!whole || X509_STORE_set_flags(store, X509_V_FLAG_CRL_CHECK) != 1)
    throw config::Error(fmt::format("the list of revoked certificates {} cannot be used: {}", file, tls_error()));
  ERR_clear_error();
}

std::string TlsContext::distrust(const ShownCertificate& shown) const {
  if (!shown.own) return "";
  if (X509_cmp_current_time(X509_get0_notAfter(shown.own.get())) < 0) return "expired";
  const bool revoked = std::any_of(revocations_.begin(), revocations_.end(), [&](const auto& list) {
    X509_REVOKED* found = nullptr;
    return X509_CRL_get0_by_cert(list.get(), &found, shown.own.get()) == 1;
  });
  if (revoked) return "revoked";
  const bool same = shown.checked_by.get() == context_;  // as long as no file was replaced
  return same || has_authority_of(shown) ? "" : "of an authority that is not trusted any more";
}

/// Whether the authorities of now certify it. Not whether it is revoked: a list that is late or missing ends no
/// connection that is open.
bool TlsContext::has_authority_of(const ShownCertificate& shown) const {
  const std::unique_ptr<X509_STORE_CTX, decltype(&X509_STORE_CTX_free)> check(X509_STORE_CTX_new(),
                                                                              X509_STORE_CTX_free);
  const char* const use = side_ == Side::client ? "ssl_server" : "ssl_client";
  bool certified =
      check &&
      X509_STORE_CTX_init(check.get(), SSL_CTX_get_cert_store(context_), shown.own.get(), shown.between.get()) == 1 &&
      X509_STORE_CTX_set_default(check.get(), use) == 1;
  if (certified) {
    X509_VERIFY_PARAM_clear_flags(X509_STORE_CTX_get0_param(check.get()), X509_V_FLAG_CRL_CHECK);
    certified = X509_verify_cert(check.get()) == 1;
  }
  ERR_clear_error();
  return certified;
}

double TlsContext::days_left() const {
  int days = 0;
  int seconds = 0;
  if (ASN1_TIME_diff(&days, &seconds, nullptr, X509_get0_notAfter(SSL_CTX_get0_certificate(context_))) != 1) return 0;
  constexpr double day_s = 24 * 60 * 60;
  return days + seconds / day_s;
}

TlsContext::~TlsContext() {
  SSL_CTX_free(context_);
}

}  // namespace iotcloud::security
