#pragma once

#include <string>
#include <vector>

namespace iotcloud::config {

/// A small installation's own authority, in one folder: ca.pem and ca.key, and for each holder NAME.pem and NAME.key.
/// Keys are elliptic (P-256) and files that only their owner may read. What is there already is never overwritten.
/// \throws Error
struct Authority {
  std::string folder;

  /// Makes the folder when there is none, and the authority in it, good for ten years.
  void make() const;
  /// A certificate for the daemons of one machine, good for two years: they serve under this name and this machine's
  /// `localhost`, and call others with it. \param host a DNS name or an address, as clients write it.
  void certify_host(const std::string& host) const;
  /// A certificate for somebody who calls, good for two years. \param name letters, digits, '-', '_' and '.'.
  void certify_caller(const std::string& name) const;

  std::string certificate(const std::string& name) const { return folder + "/" + name + ".pem"; }
  std::string key(const std::string& name) const { return folder + "/" + name + ".key"; }
};

}  // namespace iotcloud::config
