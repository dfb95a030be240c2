#pragma once

#include <functional>
#include <memory>
#include <string>

#include <iotcloud/config/exposition/http_server.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::config {

/// The answer to a GET of /metrics: all of them in Prometheus' text format. \param metrics outlives the handler.
HttpHandler metrics_page(const Metrics& metrics);

/// Serves metrics over HTTP in Prometheus' text format at /metrics, and /healthz (health_page.h), from construction to
/// destruction. A histogram is a summary in seconds with the quantiles 0.5 and 0.99, and a gauge `<name>_max`. Linked
/// by daemons only. Thread safe.
class MetricsEndpoint {
 public:
  /// \param address "host:port", for example "127.0.0.1:9100". \throws Error when it cannot be bound.
  /// \param metrics must outlive this.
  /// \param trouble why the daemon is not well; empty: it is. Called on a thread of this one.
  MetricsEndpoint(
      const std::string& address, const Metrics& metrics,
      std::function<std::string()> trouble = [] { return std::string(); });

 private:
  HttpServer server_;
};

}  // namespace iotcloud::config
