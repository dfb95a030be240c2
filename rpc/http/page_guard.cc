#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/rpc/http/page_guard.h>

namespace iotcloud::rpc {

namespace {

/// The token in a header "Authorization"; empty: there is none, which is nobody's.
std::string token_in(std::string_view authorization) {
  constexpr std::string_view scheme = "Bearer ";
  return authorization.starts_with(scheme) ? std::string(authorization.substr(scheme.size())) : std::string();
}

/// The certificates that the pages do not show, and whose days left are shown on one of them.
std::vector<std::string> watched(const PageSettings& settings) {
  auto files = settings.certificates;
  if (!settings.tls.ca.empty()) files.push_back(settings.tls.ca);
  return files;
}

}  // namespace

PageGuard::PageGuard(PageSettings settings, const config::Clock& clock, Of of)
    : settings_(std::move(settings)),
      tries_(usual_token_tries(std::chrono::milliseconds{0}), clock),
      tls_(of == Of::site ? "site" : "pages", settings_.tls,
           of == Of::site ? security::TlsContext::Side::site : security::TlsContext::Side::server),
      days_(security::certificates_in(watched(settings_)), config::process_metrics()) {
  if (const std::string problem = exposure(settings_); !problem.empty()) throw config::Error(problem);
  if (!settings_.tokens.empty() && of == Of::pages)
    tokens_ = std::make_unique<security::TokenKeeper>(settings_.tokens, "pages", clock);
}

void PageGuard::reload() {
  tls_.reload();
  if (tokens_) tokens_->reload();
}

bool PageGuard::may_try(std::string_view authorization, const std::string& caller) const {
  const std::string token = token_in(authorization);
  return !tokens_->costs(token) || tries_.enter(caller) != nullptr || !tokens_->costs(token);
}

std::optional<security::TokenEntry> PageGuard::reader(std::string_view authorization,
                                                      const std::string& certificate) const {
  return tokens_->holder(token_in(authorization), certificate);
}

}  // namespace iotcloud::rpc
