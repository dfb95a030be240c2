#include "iotcloud/security/certificate_days.h"

#include <cmath>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/security/logger.h>
#include <iotcloud/security/renewals.h>

namespace iotcloud::security {

namespace {

constexpr double few_days = 14;

}  // namespace

CertificateDays::CertificateDays(std::map<std::string, std::string> files, config::Metrics& metrics)
    : files_(std::move(files)) {
  std::vector<config::Sample> unused;
  look(unused);  // warns also where nobody asks for metrics
  source_ = metrics.add_source([this](auto& samples) { look(samples); });
}

void CertificateDays::look(std::vector<config::Sample>& samples) {
  for (const auto& [broker, file] : files_) {
    if (file.empty()) continue;
    double days = 0;
    try {
      days = days_left(file);
    } catch (const config::Error&) {  // the broker's client says so
      continue;
    }
    warn_of_end(broker, file, days);
    config::Sample sample;
    sample.name = "iotcloud_certificate_days_left";
    sample.help = "Days until a service's certificate expires";
    sample.kind = config::Sample::Kind::gauge;
    sample.labels = {{"service", "broker"}, {"broker", broker}};
    sample.value = std::floor(days);
    samples.push_back(std::move(sample));
  }
}

void CertificateDays::warn_of_end(const std::string& broker, const std::string& file, double days) {
  const config::MutexLock lock(mutex_);
  if (days >= few_days) {
    warned_.erase(broker);
  } else if (warned_.insert(broker).second) {
    certificates_logger.warn(
        "the certificate {} for the broker {} {}: replace it, for example by `iotcloud certs renew`; it is taken "
        "without a restart",
        file, broker, days < 0 ? "has expired" : "expires in " + std::to_string(static_cast<int>(days)) + " days");
  }
}

}  // namespace iotcloud::security
