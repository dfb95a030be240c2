#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/config/signing/ed25519.h>

namespace iotcloud::gateway {

/// Whose plugins a gateway runs. Immutable: thread safe.
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

  bool requires_signature() const { return required_; }
  /// The trusted key that made this signature of these bytes, by its file's name; empty: none of them.
  std::string signer(std::string_view content, std::string_view signature) const;
  /// As signer(). \param what the plugin, for messages. \throws config::Error when a signature is required and there is
  /// none, or a wrong one.
  std::string admit(const std::string& what, std::string_view content, std::string_view signature) const;

 private:
  void add(const std::string& file);

  bool required_ = false;
  std::vector<std::pair<std::string, config::PublicKey>> keys_;  ///< by name
};

}  // namespace iotcloud::gateway
