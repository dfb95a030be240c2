#include <utility>

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/ed25519.h>

namespace iotcloud::security {

namespace {

struct Free {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  void operator()(EVP_PKEY_CTX* context) const { EVP_PKEY_CTX_free(context); }
  void operator()(EVP_MD_CTX* context) const { EVP_MD_CTX_free(context); }
};
using Bio = std::unique_ptr<BIO, Free>;
using SigningKey = std::unique_ptr<EVP_PKEY, Free>;
using Digest = std::unique_ptr<EVP_MD_CTX, Free>;

const unsigned char* bytes_of(std::string_view text) {
  return reinterpret_cast<const unsigned char*>(text.data());
}

Bio reader_of(const std::string& text) {
  return Bio(BIO_new_mem_buf(text.data(), static_cast<int>(text.size())));
}

std::string text_of(const Bio& bio) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(bio.get(), &data);
  return {data, static_cast<std::size_t>(size)};
}

/// `text` says what went wrong; OpenSSL's error queue is cleared, so that its next user does not find the error.
[[noreturn]] void fail(const std::string& text) {
  ERR_clear_error();
  throw config::Error(text);
}

/// Replaces OpenSSL's question at the terminal: keys have no password.
int no_password_of_key(char*, int, int, void*) {
  return 0;
}

bool is_ed25519(const SigningKey& key) {
  return key && EVP_PKEY_get_base_id(key.get()) == EVP_PKEY_ED25519;
}

}  // namespace

KeyPair new_key_pair() {
  const SigningKey key(EVP_PKEY_Q_keygen(nullptr, nullptr, "ED25519"));
  const Bio secret(BIO_new(BIO_s_mem())), open(BIO_new(BIO_s_mem()));
  if (!key || PEM_write_bio_PrivateKey(secret.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) != 1 ||
      PEM_write_bio_PUBKEY(open.get(), key.get()) != 1)
    fail("OpenSSL cannot make an Ed25519 key; is its configuration (openssl.cnf) in order?");
  return {text_of(secret), text_of(open)};
}

std::string sign(const std::string& private_pem, const std::string& origin, std::string_view message) {
  const SigningKey key(PEM_read_bio_PrivateKey(reader_of(private_pem).get(), nullptr, &no_password_of_key, nullptr));
  if (!is_ed25519(key))
    fail(origin + ": not a private Ed25519 key in PEM without a password; `iotcloud keys new NAME` makes one");
  std::string signature(signature_bytes, '\0');
  std::size_t size = signature.size();
  const Digest context(EVP_MD_CTX_new());
  if (!context || EVP_DigestSignInit(context.get(), nullptr, nullptr, nullptr, key.get()) != 1 ||
      EVP_DigestSign(context.get(), reinterpret_cast<unsigned char*>(signature.data()), &size, bytes_of(message),
                     message.size()) != 1 ||
      size != signature_bytes)
    fail(origin + ": OpenSSL cannot sign with this key");
  return signature;
}

struct PublicKey::Impl {
  SigningKey key;
};

PublicKey PublicKey::from_pem(const std::string& pem, const std::string& origin) {
  SigningKey key(PEM_read_bio_PUBKEY(reader_of(pem).get(), nullptr, &no_password_of_key, nullptr));
  if (!is_ed25519(key))
    fail(origin + ": not a public Ed25519 key in PEM; `iotcloud keys new NAME` writes one to NAME.pub");
  auto impl = std::make_shared<Impl>();
  impl->key = std::move(key);
  return PublicKey(std::move(impl));
}

bool PublicKey::verifies(std::string_view message, std::string_view signature) const {
  if (signature.size() != signature_bytes) return false;
  const Digest context(EVP_MD_CTX_new());
  const bool good =
      context && EVP_DigestVerifyInit(context.get(), nullptr, nullptr, nullptr, impl_->key.get()) == 1 &&
      EVP_DigestVerify(context.get(), bytes_of(signature), signature.size(), bytes_of(message), message.size()) == 1;
  ERR_clear_error();
  return good;
}

}  // namespace iotcloud::security
