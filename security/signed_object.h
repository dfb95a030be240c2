#pragma once

#include <string>

#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::security {

/// A private Ed25519 key of this process. Immutable: thread safe.
class ObjectSigner {
 public:
  /// \param file as `iotcloud keys new` writes it (NAME.key). \throws config::Error if it cannot be read, is no such
  /// key, or others than its owner may read it.
  explicit ObjectSigner(const std::string& file);
  /// 64 raw bytes. \throws config::Error if OpenSSL fails.
  std::string sign(const std::string& message) const;

 private:
  const std::string file_;
  const std::string pem_;
};

/// Adds to a JSON object, as its last key, the signature of the object's bytes and of the place that they are meant
/// for: a copy elsewhere is not signed. Readers that pass over keys that they do not know read it as before. \param
/// place where it will be found, for example a path in the registry. \param object the text of a JSON object that is
/// not empty, without spaces at its end
std::string sign_object(const ObjectSigner& key, const std::string& place, const std::string& object);

/// The file name of the trusted key that made the signature of this object for this place; empty: none did.
std::string signer_of_object(const TrustedKeys& keys, const std::string& place, const std::string& bytes);

}  // namespace iotcloud::security
