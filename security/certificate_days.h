#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::security {

/// A certificate that no server of this process shows.
struct WatchedCertificate {
  std::string file;
  std::string what;       ///< for the log, behind the file's name: " for the broker kafka"
  config::Labels labels;  ///< of its metric
};
/// Those that this process, or its driver hosts, show to brokers: iotcloud_certificate_days_left{service="broker",
/// broker}. \param files by the names of the brokers; empty where there is none
std::vector<WatchedCertificate> certificates_for_brokers(const std::map<std::string, std::string>& files);
/// Any others: iotcloud_certificate_days_left{service="file", file}. \param files the same one may come twice
std::vector<WatchedCertificate> certificates_in(const std::vector<std::string>& files);

/// Shows when certificates end. Reads the files when the metrics are asked for. Warns in the log, once for each
/// certificate, from two weeks before its end. Thread safe.
class CertificateDays {
 public:
  /// \param metrics outlive this object.
  CertificateDays(std::vector<WatchedCertificate> certificates, config::Metrics& metrics);

 private:
  void look(std::vector<config::Sample>& samples);
  void warn_of_end(const WatchedCertificate& certificate, double days);

  const std::vector<WatchedCertificate> certificates_;
  config::Mutex mutex_;
  std::set<config::Labels> warned_ IOTCLOUD_GUARDED_BY(mutex_);
  config::Metrics::SourceRegistration source_;  ///< last: it uses the others
};

}  // namespace iotcloud::security
