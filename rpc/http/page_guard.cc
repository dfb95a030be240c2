#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/rpc/http/page_guard.h>

namespace iotcloud::rpc {

PageGuard::PageGuard(PageSettings settings) : settings_(std::move(settings)), tls_("pages", settings_.tls) {
  if (const std::string problem = exposure(settings_); !problem.empty()) throw config::Error(problem);
  if (!settings_.tokens.empty()) tokens_ = std::make_unique<security::TokenKeeper>(settings_.tokens, "pages");
}

void PageGuard::reload() {
  tls_.reload();
  if (tokens_) tokens_->reload();
}

std::optional<security::TokenEntry> PageGuard::reader(std::string_view authorization,
                                                      const std::string& certificate) const {
  constexpr std::string_view scheme = "Bearer ";
  if (!authorization.starts_with(scheme)) return std::nullopt;
  return tokens_->holder(std::string(authorization.substr(scheme.size())), certificate);
}

}  // namespace iotcloud::rpc
