#pragma once

#include <string>

namespace iotcloud::gateway {

/// By which driver hosts know their gateway, also its next run: a secret in the state folder, which hosts may not read
/// (`host_files`), and of it a text for each host, shown to that host alone. A host cannot find another's by its own.
/// Immutable: thread safe.
class HostProofs {
 public:
  /// Reads the secret, or makes one. \throws config::Error if it can be neither read nor written.
  explicit HostProofs(const std::string& state_folder);
  /// What to show the host with this socket (protocol::ProveGateway).
  std::string of(const std::string& socket) const;
  /// What the host is told when it starts, which everybody may see: the SHA-256 of its proof.
  std::string check_of(const std::string& socket) const;

 private:
  std::string secret_;
};

}  // namespace iotcloud::gateway
