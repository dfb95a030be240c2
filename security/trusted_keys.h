#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/security/ed25519.h>

namespace iotcloud::config {
class YamlSection;
}

namespace iotcloud::security {

/// The keys of those who may sign plugins that run here. Thread safe.
class TrustedKeys {
 public:
  struct Options {
    bool require_signature = false;
    /// Files with a public Ed25519 key in PEM, or folders of which every file that ends in .pub or .pem is one.
    std::vector<std::string> trusted_keys;
  };
  /// Trusts no key, and requires no signature.
  TrustedKeys() = default;
  /// \throws config::Error for a key that cannot be read or that every user may write, and if signatures are required
  /// but no key is trusted.
  explicit TrustedKeys(const Options& options);

  /// Reads the keys again: removed keys are no longer trusted, new ones are. Running plugins go on.
  /// \throws config::Error for a key that cannot be read or that every user may write; then nothing changes.
  void reload();
  /// A number that changes with each reload(), after which an earlier result of admit() may be out of date.
  std::uint64_t generation() const;

  bool requires_signature() const { return options_.require_signature; }
  /// The file name of the trusted key that made this signature (plugin_signature.h) of these bytes; empty: none did.
  std::string signer(std::string_view content, std::string_view signature) const;
  /// As signer(). \param what names the plugin in messages. \throws config::Error if a signature is required, and it is
  /// missing or wrong.
  std::string admit(const std::string& what, std::string_view content, std::string_view signature) const;

 private:
  using Keys = std::vector<std::pair<std::string, PublicKey>>;  ///< by name
  static Keys read(const std::vector<std::string>& paths);
  std::shared_ptr<const Keys> keys() const;

  const Options options_{};
  mutable config::Mutex mutex_;
  std::shared_ptr<const Keys> keys_ IOTCLOUD_GUARDED_BY(mutex_) = std::make_shared<const Keys>();
  std::uint64_t generation_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

/// Reads `<prefix>.require_signature` and `<prefix>.trusted_keys` of a daemon's file: who may sign what is sent to it.
std::shared_ptr<TrustedKeys> read_signers(config::YamlSection& file, const std::string& prefix);

/// Reads `<prefix>.require_version` of a daemon's file, and refuses it where no signature is needed: whoever takes a
/// signature away would take the version away with it. \param signers of the same prefix; null: they were refused
bool read_require_version(config::YamlSection& file, const std::string& prefix, const TrustedKeys* signers);

/// Reads `orders.trusted_keys` of a daemon's file: the masters whose orders it follows. \return nullptr: all masters'.
std::shared_ptr<TrustedKeys> read_trusted_masters(config::YamlSection& file);

}  // namespace iotcloud::security
