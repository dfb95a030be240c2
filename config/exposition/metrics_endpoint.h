#pragma once

#include <memory>
#include <string>

#include <iotcloud/config/metrics.h>

namespace iotcloud::config {

/// Serves metrics over HTTP in Prometheus' text format at /metrics, from construction to destruction. A histogram is a
/// summary in seconds with the quantiles 0.5 and 0.99, and a gauge `<name>_max`. Linked by daemons only. Thread safe.
class MetricsEndpoint {
 public:
  /// \param address "host:port", for example "127.0.0.1:9100". \throws Error when it cannot be bound.
  /// \param metrics must outlive this.
  MetricsEndpoint(const std::string& address, const Metrics& metrics);
  ~MetricsEndpoint();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::config
