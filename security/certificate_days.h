#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::security {

/// Shows when the certificates end that this process, or its driver hosts, show to brokers:
/// iotcloud_certificate_days_left{service="broker", broker}. Reads the files when the metrics are asked for. Warns in
/// the log, once for each certificate, from two weeks before its end. Thread safe.
class CertificateDays {
 public:
  /// \param files of the certificates, by the names of their brokers; without one where it is empty. \param metrics
  /// outlive this object.
  CertificateDays(std::map<std::string, std::string> files, config::Metrics& metrics);

 private:
  void look(std::vector<config::Sample>& samples);
  void warn_of_end(const std::string& broker, const std::string& file, double days);

  const std::map<std::string, std::string> files_;
  config::Mutex mutex_;
  std::set<std::string> warned_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the brokers
  config::Metrics::SourceRegistration source_;                ///< last: it uses the others
};

}  // namespace iotcloud::security
