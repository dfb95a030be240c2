#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>

namespace iotcloud::config {

/// Ed25519 (RFC 8032, pure) over a whole message. Keys are PEM (PKCS #8 and SubjectPublicKeyInfo), signatures 64 raw
/// bytes: what `openssl genpkey -algorithm ed25519`, `openssl pkey -pubout` and `openssl pkeyutl -sign -rawin` make.

inline constexpr std::size_t signature_bytes = 64;

struct KeyPair {
  std::string private_pem;  ///< to be kept from others
  std::string public_pem;
};
/// \throws config::Error when the system has no randomness.
KeyPair new_key_pair();

/// \param private_pem without a password. \param origin of the key, for messages.
/// \throws config::Error when it is no private Ed25519 key.
std::string sign(const std::string& private_pem, const std::string& origin, std::string_view message);

/// One who is trusted. Immutable: thread safe. Cheap to copy.
class PublicKey {
 public:
  /// \param origin of the text, for messages. \throws config::Error when it is no public Ed25519 key.
  static PublicKey from_pem(const std::string& pem, const std::string& origin);
  /// False for anything that is not this key's signature of this message, of a wrong length too.
  bool verifies(std::string_view message, std::string_view signature) const;

 private:
  struct Impl;
  explicit PublicKey(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
  std::shared_ptr<const Impl> impl_;
};

}  // namespace iotcloud::config
