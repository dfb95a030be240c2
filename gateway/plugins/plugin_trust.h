#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/config/signing/ed25519.h>

namespace iotcloud::gateway {

/// Whose plugins a gateway runs. Thread safe.
class PluginTrust {
 public:
  struct Options {
    bool require_signature = false;
    /// Files with a public Ed25519 key in PEM, or folders of which every file that ends in .pub or .pem is one.
    std::vector<std::string> trusted_keys;
  };
  /// Nobody is trusted, and no signature is asked for.
  PluginTrust() = default;
  /// \throws config::Error for a key that cannot be read or that anybody may change, and when signatures are required
  /// but nobody is trusted.
  explicit PluginTrust(const Options& options);

  /// Reads the keys again: those that are gone are not trusted any more, new ones are. What runs goes on.
  /// \throws config::Error for a key that cannot be read or that anybody may change, and then nothing changes.
  void reload();
  /// Another number after each reload(): what was admitted before need not be now.
  std::uint64_t generation() const;

  bool requires_signature() const { return options_.require_signature; }
  /// The trusted key that made this signature of these bytes, by its file's name; empty: none of them.
  std::string signer(std::string_view content, std::string_view signature) const;
  /// As signer(). \param what the plugin, for messages. \throws config::Error when a signature is required and there is
  /// none, or a wrong one.
  std::string admit(const std::string& what, std::string_view content, std::string_view signature) const;

 private:
  using Keys = std::vector<std::pair<std::string, config::PublicKey>>;  ///< by name
  static Keys read(const std::vector<std::string>& paths);
  std::shared_ptr<const Keys> keys() const;

  const Options options_{};
  mutable std::mutex mutex_;
  std::shared_ptr<const Keys> keys_ = std::make_shared<const Keys>();  ///< guarded by mutex_
  std::uint64_t generation_ = 0;                                       ///< guarded by mutex_
};

}  // namespace iotcloud::gateway
