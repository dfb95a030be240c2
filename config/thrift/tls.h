#pragma once

#include <string>

#include <iotcloud/config/yaml.h>

struct ssl_ctx_st;  // OpenSSL's SSL_CTX

namespace iotcloud::config {

/// Who one is and whom one trusts, as files in PEM form. All empty: no TLS.
struct TlsFiles {
  std::string ca;           ///< the authorities whose certificates are believed
  std::string certificate;  ///< one's own, with those between it and the authority behind it
  std::string key;          ///< its private key, without a password
  bool empty() const { return ca.empty() && certificate.empty() && key.empty(); }
  friend bool operator==(const TlsFiles&, const TlsFiles&) = default;
};

/// Reads `tls: {ca, certificate, key}`; all three are needed, and are tried. No such section: no TLS.
/// \throws ConfigError when one is missing or cannot be used, with file, line and remedy.
TlsFiles read_tls(Section& section);

/// What connections of one side share: TLS 1.2 or later, both sides show a certificate of the authority. Sessions are
/// not resumed, so that every connection is checked anew. Thread safe.
class TlsContext {
 public:
  enum class Side { server, client };
  /// \throws Error that names the file that cannot be used.
  TlsContext(const TlsFiles& files, Side side);
  ~TlsContext();
  TlsContext(const TlsContext&) = delete;
  TlsContext& operator=(const TlsContext&) = delete;

  ssl_ctx_st* get() const { return context_; }
  Side side() const { return side_; }

 private:
  ssl_ctx_st* context_;
  const Side side_;
};

/// What OpenSSL says went wrong on this thread, in one line, and forgets it; "unknown error" when it says nothing.
std::string tls_error();

}  // namespace iotcloud::config
