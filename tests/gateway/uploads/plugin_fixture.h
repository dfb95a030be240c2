#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/signing/ed25519.h>
#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/gateway/plugins/plugin_store.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::gateway {

/// Time that a test moves.
class MovedClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 1; }
  void move(std::chrono::milliseconds by) { now_ += by; }

 private:
  Instant now_{std::chrono::hours{1}};
};

inline std::string error_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

using tests::read_file;

/// A folder of its own, with a key pair "lab" that may be trusted.
class PluginFolder : public ::testing::Test {
 protected:
  PluginFolder() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-plugins-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    write("lab.pub", lab_.public_pem);
  }
  ~PluginFolder() override { std::filesystem::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& bytes) const {
    return tests::write_file(folder_ / name, bytes);
  }
  std::shared_ptr<const PluginTrust> trust(bool required) const {
    PluginTrust::Options options;
    options.require_signature = required;
    options.trusted_keys = {folder_ / "lab.pub"};
    return std::make_shared<const PluginTrust>(options);
  }
  std::string signature_of(const std::string& bytes) const { return config::sign(lab_.private_pem, "lab", bytes); }

  std::filesystem::path folder_;
  const config::KeyPair lab_ = config::new_key_pair();
};

}  // namespace iotcloud::gateway
