#pragma once

#include <array>
#include <memory>
#include <string>

#include <iotcloud/config/file_stamp.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::security {

/// The TLS of a service whose certificate, key, authorities and revocations are replaced while it runs. Sets
/// iotcloud_certificate_days_left{service}. Thread safe.
class ServerTls {
 public:
  /// \param service the metric's label. \param files empty: no TLS. \param side server or site
  /// \throws config::Error that names the unusable file
  ServerTls(const std::string& service, TlsFiles files, TlsContext::Side side = TlsContext::Side::server);

  /// Reads the files. \throws config::Error that names the unusable file; then what was read before counts.
  void reload();
  /// Reads the files if one was replaced since they were last read, and sets the metric.
  /// \return why they are of no use, so that what was read before counts; empty: nothing is wrong. Said once.
  std::string look();
  /// For new connections, and to ask whether the certificate of an open one is still trusted; null: no TLS.
  std::shared_ptr<const TlsContext> context() const;

 private:
  using Stamps = std::array<config::FileStamp, 4>;
  Stamps stamps() const;
  void read() IOTCLOUD_REQUIRES(reading_);

  const TlsFiles files_;
  const TlsContext::Side side_;
  config::Gauge* const days_left_;  ///< null: no TLS
  config::Mutex reading_;  ///< one reading at a time, so that the last one that begins is the last one that counts
  Stamps seen_ IOTCLOUD_GUARDED_BY(reading_){};
  mutable config::Mutex mutex_;
  std::shared_ptr<const TlsContext> context_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::security
