#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>

namespace iotcloud::security {

/// Ed25519 (RFC 8032, pure) over a whole message. Keys are PEM (PKCS #8 and SubjectPublicKeyInfo), signatures 64 raw
/// bytes, as `openssl genpkey -algorithm ed25519`, `openssl pkey -pubout` and `openssl pkeyutl -sign -rawin` write
/// them.

inline constexpr std::size_t signature_bytes = 64;

/// A private key and its public half, in PEM form.
struct KeyPair {
  std::string private_pem;  ///< keep it secret
  std::string public_pem;
};
/// \throws config::Error if the system has no randomness.
KeyPair new_key_pair();

/// \param private_pem without a password. \param origin the key's source, for messages.
/// \throws config::Error if it is not a private Ed25519 key.
std::string sign(const std::string& private_pem, const std::string& origin, std::string_view message);

/// A trusted signer's key. Immutable: thread safe. Cheap to copy.
class PublicKey {
 public:
  /// \param origin the text's source, for messages. \throws config::Error if it is not a public Ed25519 key.
  static PublicKey from_pem(const std::string& pem, const std::string& origin);
  /// False unless `signature` is this key's signature of this message; false for a wrong length too.
  bool verifies(std::string_view message, std::string_view signature) const;

 private:
  struct Impl;
  explicit PublicKey(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
  std::shared_ptr<const Impl> impl_;
};

}  // namespace iotcloud::security
