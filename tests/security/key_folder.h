#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::security {

inline std::string error_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

/// A folder for each test, with a key pair "lab" that a test may declare trusted.
class KeyFolder : public ::testing::Test {
 protected:
  KeyFolder() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-keys-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    write("lab.pub", lab_.public_pem);
  }
  ~KeyFolder() override { std::filesystem::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& bytes) const {
    return tests::write_file(folder_ / name, bytes);
  }
  std::shared_ptr<const TrustedKeys> trust(bool required) const {
    TrustedKeys::Options options;
    options.require_signature = required;
    options.trusted_keys = {folder_ / "lab.pub"};
    return std::make_shared<const TrustedKeys>(options);
  }
  std::string signature_of(const std::string& bytes) const { return sign(lab_.private_pem, "lab", bytes); }

  std::filesystem::path folder_;
  const KeyPair lab_ = new_key_pair();
};

}  // namespace iotcloud::security
