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

std::vector<WatchedCertificate> certificates_for_brokers(const std::map<std::string, std::string>& files) {
  std::vector<WatchedCertificate> certificates;
  for (const auto& [broker, file] : files) {
    if (!file.empty())
      certificates.push_back({file, " for the broker " + broker, {{"service", "broker"}, {"broker", broker}}});
  }
  return certificates;
}

std::vector<WatchedCertificate> certificates_in(const std::vector<std::string>& files) {
  std::vector<WatchedCertificate> certificates;
  for (const auto& file : std::set<std::string>(files.begin(), files.end()))
    certificates.push_back({file, "", {{"service", "file"}, {"file", file}}});
  return certificates;
}

CertificateDays::CertificateDays(std::vector<WatchedCertificate> certificates, config::Metrics& metrics)
    : certificates_(std::move(certificates)) {
  std::vector<config::Sample> unused;
  look(unused);  // warns also where nobody asks for metrics
  source_ = metrics.add_source([this](auto& samples) { look(samples); });
}

void CertificateDays::look(std::vector<config::Sample>& samples) {
  for (const auto& certificate : certificates_) {
    double days = 0;
    try {
      days = days_left(certificate.file);
    } catch (const config::Error&) {  // whoever uses it says so
      continue;
    }
    warn_of_end(certificate, days);
    config::Sample sample;
    sample.name = "iotcloud_certificate_days_left";
    sample.help = "Days until a service's certificate expires";
    sample.kind = config::Sample::Kind::gauge;
    sample.labels = certificate.labels;
    sample.value = std::floor(days);
    samples.push_back(std::move(sample));
  }
}

void CertificateDays::warn_of_end(const WatchedCertificate& certificate, double days) {
  const config::MutexLock lock(mutex_);
  if (days >= few_days) {
    warned_.erase(certificate.labels);
  } else if (warned_.insert(certificate.labels).second) {
    certificates_logger.warn(
        "the certificate {}{} {}: replace it, for example by `iotcloud certs renew`; the daemons take it without a "
        "restart",
        certificate.file, certificate.what,
        days < 0 ? "has expired" : "expires in " + std::to_string(static_cast<int>(days)) + " days");
  }
}

}  // namespace iotcloud::security
