#pragma once

#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>

struct ssl_ctx_st;     // OpenSSL's SSL_CTX
struct ssl_st;         // OpenSSL's SSL
struct stack_st_X509;  // OpenSSL's STACK_OF(X509)
struct x509_st;        // OpenSSL's X509
struct X509_crl_st;    // OpenSSL's X509_CRL

namespace iotcloud::security {

/// This side's identity and its trusted authorities, as PEM files. All empty: no TLS.
struct TlsFiles {
  std::string ca;           ///< the trusted authorities
  std::string certificate;  ///< the own certificate, followed by those between it and the authority
  std::string key;          ///< the certificate's private key, without a password
  /// certificates of the authorities that are worth nothing any more (lists of revocations, one for each authority);
  /// empty: no such list
  std::string revoked{};
  bool empty() const { return ca.empty() && certificate.empty() && key.empty(); }
  friend bool operator==(const TlsFiles&, const TlsFiles&) = default;
};

/// Reads `tls: {ca, certificate, key, revoked}`; the first three are needed, and all are checked. Without the section:
/// no TLS. \throws ConfigError if one is missing or unusable, with file, line and remedy.
TlsFiles read_tls(config::YamlSection& section);

/// What the other side of a connection showed at the handshake.
struct ShownCertificate {
  std::shared_ptr<x509_st> own{};            ///< null: none
  std::shared_ptr<stack_st_X509> between{};  ///< those between it and an authority; null: none
  std::shared_ptr<ssl_ctx_st> checked_by{};  ///< TlsContext::get() of the handshake
};
ShownCertificate shown_certificate(const ssl_st* ssl);

/// The settings that all connections of one side share: TLS 1.2 or later; both sides show a certificate of the
/// authority, but for the readers of a site. Sessions are not resumed, so that every connection is checked anew. Thread
/// safe.
class TlsContext {
 public:
  /// Which end of a connection it is for. `site`: a server of people's browsers, which need not show a certificate; one
  /// that they show must be of the authority.
  enum class Side { server, client, site };
  /// \throws Error that names the unusable file.
  TlsContext(const TlsFiles& files, Side side);
  ~TlsContext();
  TlsContext(const TlsContext&) = delete;
  TlsContext& operator=(const TlsContext&) = delete;

  ssl_ctx_st* get() const { return context_; }
  /// Why a certificate that was trusted when its connection began is not any more: "revoked", "expired", "of an
  /// authority that is not trusted any more"; empty: it is, or there is none.
  std::string distrust(const ShownCertificate& shown) const;
  /// Days until this side's own certificate expires.
  double days_left() const;
  Side side() const { return side_; }

 private:
  void load_revocations(const std::string& file);
  bool has_authority_of(const ShownCertificate& shown) const;

  ssl_ctx_st* context_;
  std::vector<std::shared_ptr<X509_crl_st>> revocations_;
  const Side side_;
};

/// Makes the handshake of a client fail unless the server's certificate is for this host: a DNS name or an address.
void expect_host(ssl_st* ssl, const std::string& host);
/// The subject of the other side's certificate, "CN=operator"; empty if it showed none.
std::string peer_subject(const ssl_st* ssl);

/// A daemon that masters show tokens of its own: the certificate there must name it.
struct NamedDaemon {
  /// Gateways and pools of workers have ids of their own: a gateway is not the pool that has the same id.
  enum class Kind { gateway, pool };
  Kind kind = Kind::gateway;
  std::string id;
};
std::string to_string(NamedDaemon::Kind kind);
/// The alternative name (URI) in the certificate of a machine on which the daemon runs.
std::string uri_of(const NamedDaemon& daemon);
/// Whether the other side's certificate is that of this daemon: its common name is the daemon's id, or it has the
/// alternative name uri_of(daemon). False without a certificate.
bool is_peer(const ssl_st* ssl, const NamedDaemon& daemon);
/// The subject in a file with a certificate, as peer_subject(). \throws Error if there is none.
std::string subject_in(const std::string& file);

/// Takes OpenSSL's error of this thread, in one line, and clears it; "unknown error" if there is none.
std::string tls_error();

}  // namespace iotcloud::security
