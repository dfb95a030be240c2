#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include <iotcloud/security/ed25519.h>

namespace iotcloud::security {

/// A plugin's signature, as its file has it: the 64 bytes of an Ed25519 signature of the plugin's bytes, or one line
/// "iotcloud-plugin NAME VERSION" and the 64 bytes of a signature of that line and the plugin's bytes. With a line the
/// signer says which plugin this is and which version, so that a gateway does not go back to an old one.
struct PluginSignature {
  std::string name;           ///< empty: signed without name and version
  std::uint64_t version = 0;  ///< from 1; 0: signed without
  std::string head;           ///< the line with its end, which is signed before the plugin's bytes; empty: none
  std::string bytes;          ///< the Ed25519 signature
};

/// The longest text of a signature.
inline constexpr std::size_t most_plugin_signature_bytes = 256;

/// Splits a signature's text. Text that has no such form is all in `bytes`, and no key verifies it.
PluginSignature parse_plugin_signature(std::string_view text);
/// Whether the text has the form of a signature.
bool is_plugin_signature(std::string_view text);

/// Signs a plugin with its name and version. \param private_pem, origin as sign().
/// \throws config::Error for a name that is not 1 to 64 letters, digits, '.', '-' and '_', and for version 0
std::string sign_plugin(const std::string& private_pem, const std::string& origin, std::string_view content,
                        const std::string& name, std::uint64_t version);

}  // namespace iotcloud::security
