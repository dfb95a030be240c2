#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/rpc/http/page_guard.h>

namespace iotcloud::rpc {

PageGuard::PageGuard(PageSettings settings) : settings_(std::move(settings)) {
  if (const std::string problem = exposure(settings_); !problem.empty()) throw config::Error(problem);
  if (!settings_.tokens.empty()) tokens_ = std::make_unique<security::TokenKeeper>(settings_.tokens, "pages");
  reload();
}

void PageGuard::reload() {
  if (!settings_.tls.empty()) {
    auto read = std::make_shared<const security::TlsContext>(settings_.tls, security::TlsContext::Side::server);
    const config::MutexLock lock(mutex_);
    tls_ = std::move(read);
  }
  if (tokens_) tokens_->reload();
}

std::shared_ptr<const security::TlsContext> PageGuard::tls() const {
  const config::MutexLock lock(mutex_);
  return tls_;
}

std::optional<security::TokenEntry> PageGuard::reader(std::string_view authorization,
                                                      const std::string& certificate) const {
  constexpr std::string_view scheme = "Bearer ";
  if (!authorization.starts_with(scheme)) return std::nullopt;
  return tokens_->holder(std::string(authorization.substr(scheme.size())), certificate);
}

}  // namespace iotcloud::rpc
