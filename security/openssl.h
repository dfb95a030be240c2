#pragma once

// Private: what the sources that make and read certificates share on top of OpenSSL.
#include <memory>
#include <string>

#include <fmt/format.h>
#include <openssl/bn.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509v3.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::security::openssl {

template <auto Free>
struct Freed {
  template <typename Object>
  void operator()(Object* object) const {
    Free(object);
  }
};
using Key = std::unique_ptr<EVP_PKEY, Freed<EVP_PKEY_free>>;
using Certificate = std::unique_ptr<X509, Freed<X509_free>>;
using RevocationList = std::unique_ptr<X509_CRL, Freed<X509_CRL_free>>;
using Memory = std::unique_ptr<BIO, Freed<BIO_free_all>>;

inline constexpr long day_s = 24L * 60 * 60;
inline constexpr long authority_days = 3650;
/// How far the clock of a machine that checks a certificate may be behind.
inline constexpr long clock_error_s = 60L * 60;

/// \throws config::Error with OpenSSL's reason unless `done`. \param what as in "OpenSSL cannot make a key"
inline void must(bool done, const char* what) {
  if (!done) throw config::Error(fmt::format("OpenSSL cannot {}: {}", what, tls_error()));
}

/// The bytes that were written into a BIO of memory.
inline std::string written_to(BIO* memory) {
  char* data = nullptr;
  const auto size = BIO_get_mem_data(memory, &data);
  return {data, static_cast<std::size_t>(size)};
}

inline std::string pem_of(X509* certificate) {
  const Memory memory(BIO_new(BIO_s_mem()));
  must(PEM_write_bio_X509(memory.get(), certificate) == 1, "write a certificate");
  return written_to(memory.get());
}

inline std::string pem_of(EVP_PKEY* key) {
  const Memory memory(BIO_new(BIO_s_mem()));
  must(PEM_write_bio_PrivateKey(memory.get(), key, nullptr, nullptr, 0, nullptr, nullptr) == 1, "write a key");
  return written_to(memory.get());
}

inline Key make_key() {
  // Not EVP_EC_gen("P-256"): clang warns that its macro casts a const away.
  Key key(EVP_PKEY_Q_keygen(nullptr, nullptr, "EC", "P-256"));
  must(key != nullptr, "make a key");
  return key;
}

/// Reads a file of PEM. \param read takes a BIO and returns an owner, which is empty if the text is not what it wants.
/// \throws config::Error
template <typename Read>
auto read_file(const std::string& file, Read&& read) {
  const Memory in(BIO_new_file(file.c_str(), "r"));
  auto object = in ? read(in.get()) : decltype(read(in.get())){};
  if (!object)
    throw config::Error(
        fmt::format("{} cannot be read: {}; `iotcloud certs init` makes an authority", file, tls_error()));
  return object;
}

inline Certificate read_certificate(const std::string& file) {
  return read_file(file, [](BIO* in) { return Certificate(PEM_read_bio_X509(in, nullptr, nullptr, nullptr)); });
}
inline Key read_key(const std::string& file) {
  return read_file(file, [](BIO* in) { return Key(PEM_read_bio_PrivateKey(in, nullptr, nullptr, nullptr)); });
}

/// Gives the certificate a new random serial number, and the time from now on for so many days.
inline void date_and_number(X509* certificate, long days) {
  constexpr int serial_bits = 127;
  const std::unique_ptr<BIGNUM, Freed<BN_free>> serial(BN_new());
  must(serial && BN_rand(serial.get(), serial_bits, BN_RAND_TOP_ANY, BN_RAND_BOTTOM_ANY) == 1 &&
           BN_to_ASN1_INTEGER(serial.get(), X509_get_serialNumber(certificate)) != nullptr,
       "make a serial number");
  must(X509_gmtime_adj(X509_getm_notBefore(certificate), -clock_error_s) != nullptr &&
           X509_gmtime_adj(X509_getm_notAfter(certificate), days * day_s) != nullptr,
       "date a certificate");
}

}  // namespace iotcloud::security::openssl
