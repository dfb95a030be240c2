#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include <iotcloud/rpc/call_limits.h>
#include <iotcloud/rpc/http/page_settings.h>
#include <iotcloud/security/certificate_days.h>
#include <iotcloud/security/server_tls.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::rpc {

/// Decides who may read a daemon's pages. Thread safe. Private to the sources of the pages.
class PageGuard {
 public:
  /// Of what a server has: pages, whose readers show the token with each request, or a site, which asks for tokens by
  /// itself, and whose readers need no certificate.
  enum class Of { pages, site };
  /// \throws config::Error for unusable files, and if exposure() gives a reason.
  explicit PageGuard(PageSettings settings, const config::Clock& clock = config::system_clock(), Of of = Of::pages);
  /// Reads certificates again, then tokens. \throws config::Error; an unusable file and later ones count as before.
  void reload();

  security::ServerTls& tls() { return tls_; }
  bool asks_for_token() const { return tokens_ != nullptr; }
  /// Whether the reader may try this header "Authorization"; false: it tried too many that nobody had shown before.
  /// \param caller the subject of the reader's certificate, or its host
  bool may_try(std::string_view authorization, const std::string& caller) const;
  /// The user whom this header proves; nullopt: nobody who may read. Takes some ten milliseconds for a token that was
  /// not shown before.
  /// \param certificate the subject of the reader's certificate; empty: none
  std::optional<security::TokenEntry> reader(std::string_view authorization, const std::string& certificate) const;
  /// Whether the token still counts.
  bool still_may(const security::TokenEntry& reader) const { return tokens_->role_of(reader).has_value(); }

 private:
  const PageSettings settings_;
  std::unique_ptr<security::TokenKeeper> tokens_;  ///< null: readers need no token
  /// The pages have one thread, so a try does not wait for its turn.
  mutable CallLimits tries_;
  security::ServerTls tls_;
  security::CertificateDays days_;
};

}  // namespace iotcloud::rpc
