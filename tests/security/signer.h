#pragma once

#include <filesystem>
#include <string>

#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::security::test {

/// A key pair in a folder: NAME.key and NAME.pub.
class Signer {
 public:
  /// \param folder with a slash at its end
  Signer(const std::string& folder, const std::string& name)
      : open_(tests::write_file(folder + name + ".pub", pair_.public_pem)),
        key_(private_file(folder + name + ".key", pair_.private_pem)) {}
  const std::string& public_file() const { return open_; }
  const ObjectSigner& key() const { return key_; }

 private:
  static std::string private_file(const std::string& path, const std::string& pem) {
    tests::write_file(path, pem);
    std::filesystem::permissions(path, std::filesystem::perms::owner_read);
    return path;
  }
  const KeyPair pair_ = new_key_pair();
  const std::string open_;
  const ObjectSigner key_;
};

}  // namespace iotcloud::security::test
