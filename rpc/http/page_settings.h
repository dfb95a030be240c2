#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

/// Where a daemon's pages are served, and who may read them.
struct PageSettings {
  std::string address;     ///< host:port; empty: no pages
  security::TlsFiles tls;  ///< if not empty, readers show a certificate of its authority
  std::string tokens;      ///< file of tokens (security/tokens.h); empty: readers need none. Every role may read
  /// How often the server looks whether the TLS files have changed, and whether readers' certificates still count.
  std::chrono::milliseconds look_period{5'000};
  /// Files of certificates that nobody else watches, as that of the tunnel to the registry: beside that of the
  /// authority in `tls`, the metrics show their days left.
  std::vector<std::string> certificates{};
};

/// Reads `metrics: {address, tls: {ca, certificate, key}, tokens, certificates}`. Without the section there are no
/// pages. \throws ConfigError, also if exposure() gives a reason.
PageSettings read_page_settings(config::YamlSection& file);

/// Why no pages may be served with these settings; empty: they may. They show data, so an address that other machines
/// can reach needs TLS and tokens.
std::string exposure(const PageSettings& settings);

}  // namespace iotcloud::rpc
