#include <cmath>
#include <cstdint>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/security/server_tls.h>

namespace iotcloud::security {

ServerTls::ServerTls(const std::string& service, TlsFiles files, TlsContext::Side side)
    : files_(std::move(files)),
      side_(side),
      days_left_(files_.empty() ? nullptr
                                : &config::process_metrics().gauge("iotcloud_certificate_days_left",
                                                                   "Days until a service's certificate expires",
                                                                   {{"service", service}})) {
  reload();
}

void ServerTls::reload() {
  if (files_.empty()) return;
  const config::MutexLock lock(reading_);
  read();
}

void ServerTls::read() {
  // Before the files are read: look() notices one that is replaced meanwhile, and reads one that is of no use again
  // only when it has changed.
  seen_ = stamps();
  auto fresh = std::make_shared<const TlsContext>(files_, side_);
  const config::MutexLock lock(mutex_);
  context_ = std::move(fresh);
}

std::string ServerTls::look() {
  if (files_.empty()) return "";
  std::string problem;
  try {
    const config::MutexLock lock(reading_);
    if (seen_ != stamps()) read();
  } catch (const config::Error& e) {
    problem = e.what();
  }
  days_left_->set(static_cast<std::int64_t>(std::floor(context()->days_left())));
  return problem;
}

std::shared_ptr<const TlsContext> ServerTls::context() const {
  const config::MutexLock lock(mutex_);
  return context_;
}

ServerTls::Stamps ServerTls::stamps() const {
  return {config::stamp_of(files_.ca), config::stamp_of(files_.certificate), config::stamp_of(files_.key),
          config::stamp_of(files_.revoked)};
}

}  // namespace iotcloud::security
