#pragma once

#include <string>
#include <vector>

namespace iotcloud::security {

/// Daemons that a certificate names, by their ids: masters show each of them a token of its own.
struct NamedIds {
  std::vector<std::string> gateways{};
  std::vector<std::string> pools{};
};

/// A small installation's own authority, in one folder: ca.pem and ca.key, and for each holder NAME.pem and NAME.key.
/// Keys are elliptic (P-256), in files that only their owner may read. Existing files are never overwritten. \throws
/// Error
struct Authority {
  std::string folder;

  /// Makes the folder if it is missing, and the authority in it, valid for ten years.
  void make() const;
  /// Makes a certificate for the daemons of one machine, valid for two years: they serve under `host` and this
  /// machine's `localhost`, and call others with it. \param host a DNS name or an address, as clients write it.
  /// \param named the gateways and pools on that machine: masters send their tokens only to one that the certificate
  /// names.
  void certify_host(const std::string& host, const NamedIds& named = {}) const;
  /// As certify_host(), with a name and a key of its own for one of a machine's daemons: whoever has taken over that
  /// daemon has no other one's certificate. \param name the common name, and that of the files: letters, digits, '-',
  /// '_', '.'; clients do not reach it under this name. \param hosts the machine's names and addresses.
  void certify_daemon(const std::string& name, const std::vector<std::string>& hosts, const NamedIds& named = {}) const;
  /// Makes a certificate for a client, valid for two years. \param name letters, digits, '-', '_' and '.'.
  void certify_caller(const std::string& name) const;

  std::string certificate(const std::string& name) const { return folder + "/" + name + ".pem"; }
  std::string key(const std::string& name) const { return folder + "/" + name + ".key"; }
};

}  // namespace iotcloud::security
