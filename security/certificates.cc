#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <sys/stat.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/security/certificates.h>
#include <iotcloud/security/openssl.h>
#include <iotcloud/security/private_file.h>

namespace iotcloud::security {

namespace {

using namespace openssl;

constexpr long holder_days = 730;

void extend(X509* certificate, X509* issuer, int kind, const std::string& value) {
  X509V3_CTX context;
  X509V3_set_ctx_nodb(&context);
  X509V3_set_ctx(&context, issuer, certificate, nullptr, nullptr, 0);
  X509_EXTENSION* const extension = X509V3_EXT_conf_nid(nullptr, &context, kind, value.c_str());
  must(extension != nullptr, "make an extension of a certificate");
  const int added = X509_add_ext(certificate, extension, -1);
  X509_EXTENSION_free(extension);
  must(added == 1, "add an extension to a certificate");
}

/// Makes a certificate without extensions and signature. \param issuer null: self-signed
Certificate begin(const std::string& name, EVP_PKEY* key, X509* issuer, long days) {
  Certificate certificate(X509_new());
  must(certificate != nullptr, "make a certificate");
  X509* const made = certificate.get();
  must(X509_set_version(made, X509_VERSION_3) == 1, "make a certificate");
  date_and_number(made, days);
  const auto* const text = reinterpret_cast<const unsigned char*>(name.c_str());
  must(X509_NAME_add_entry_by_txt(X509_get_subject_name(made), "CN", MBSTRING_UTF8, text, -1, -1, 0) == 1,
       "name a certificate");
  must(X509_set_issuer_name(made, X509_get_subject_name(issuer != nullptr ? issuer : made)) == 1, "name an issuer");
  must(X509_set_pubkey(made, key) == 1, "put a key into a certificate");
  return certificate;
}

void check_name(const std::string& name) {
  const auto good = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '-' || c == '_' || c == '.' || c == ':';
  };
  if (name.empty() || name.size() > 64 || name.front() == '.' || name.front() == '-' || name == "ca" ||
      !std::all_of(name.begin(), name.end(), good))
    throw config::Error(
        fmt::format("\"{}\" cannot be the name in a certificate: 1 to 64 letters, digits, '.', '-' and '_', "
                    "and not \"ca\"",
                    name));
}

/// \param names alternative names of the subject in OpenSSL's notation; empty: none
void certify(const Authority& authority, const std::string& name, const std::string& usage, const std::string& names) {
  check_name(name);
  const auto issuer = read_certificate(authority.certificate("ca"));
  const auto signer = read_key(authority.key("ca"));
  const Key key = make_key();
  const Certificate certificate = begin(name, key.get(), issuer.get(), holder_days);
  const auto add = [&](int kind, const std::string& value) { extend(certificate.get(), issuer.get(), kind, value); };
  add(NID_basic_constraints, "critical,CA:FALSE");
  add(NID_key_usage, "critical,digitalSignature");
  add(NID_ext_key_usage, usage);
  add(NID_authority_key_identifier, "keyid");
  if (!names.empty()) add(NID_subject_alt_name, names);
  must(X509_sign(certificate.get(), signer.get(), EVP_sha256()) > 0, "sign a certificate");
  config::write_new_file(authority.key(name), pem_of(key.get()), for_owner);
  config::write_new_file(authority.certificate(name), pem_of(certificate.get()), for_readers);
}

}  // namespace

void Authority::make() const {
  constexpr mode_t only_owner = 0700;
  if (mkdir(folder.c_str(), only_owner) != 0 && errno != EEXIST)
    throw config::Error(fmt::format("the folder {} cannot be made: {}", folder, std::strerror(errno)));
  const Key pair = make_key();
  const Certificate certificate = begin("IoTCloud authority", pair.get(), nullptr, authority_days);
  X509* const made = certificate.get();
  extend(made, made, NID_basic_constraints, "critical,CA:TRUE,pathlen:0");
  extend(made, made, NID_key_usage, "critical,keyCertSign,cRLSign");
  extend(made, made, NID_subject_key_identifier, "hash");
  must(X509_sign(made, pair.get(), EVP_sha256()) > 0, "sign a certificate");
  config::write_new_file(key("ca"), pem_of(pair.get()), for_owner);
  config::write_new_file(this->certificate("ca"), pem_of(made), for_readers);
}

void Authority::certify_host(const std::string& host, const NamedIds& named) const {
  certify_daemon(host, {host}, named);
}

void Authority::certify_daemon(const std::string& name, const std::vector<std::string>& hosts,
                               const NamedIds& named) const {
  std::string names;
  for (const auto& host : hosts) {
    check_name(host);
    names += fmt::format("{}:{},", config::is_address(host) ? "IP" : "DNS", host);
  }
  names += "DNS:localhost,IP:127.0.0.1,IP:::1";
  const auto add = [&](NamedDaemon::Kind kind, const std::vector<std::string>& ids) {
    for (const auto& id : ids) {
      check_name(id);
      names += ",URI:" + uri_of({kind, id});
    }
  };
  add(NamedDaemon::Kind::gateway, named.gateways);
  add(NamedDaemon::Kind::pool, named.pools);
  certify(*this, name, "serverAuth,clientAuth", names);
}

void Authority::certify_caller(const std::string& name) const {
  certify(*this, name, "clientAuth", "");
}

}  // namespace iotcloud::security
