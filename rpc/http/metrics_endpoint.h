#pragma once

#include <functional>
#include <memory>
#include <string>

#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/http/http_server.h>

namespace iotcloud::rpc {

/// Answers a GET of /metrics with all metrics in Prometheus' text format. \param metrics must outlive the handler.
HttpHandler metrics_page(const config::Metrics& metrics);

/// Serves metrics over HTTP in Prometheus' text format at /metrics, and /healthz (health_page.h), from construction to
/// destruction. A histogram becomes a summary in seconds with the quantiles 0.5 and 0.99, and a gauge `<name>_max`.
/// Only daemons link it. Thread safe.
class MetricsEndpoint {
 public:
  /// \param address "host:port", for example "127.0.0.1:9100". \throws Error if it cannot be bound.
  /// \param metrics must outlive this object.
  /// \param trouble why the daemon is unhealthy; empty if it is healthy. Called on this object's thread.
  MetricsEndpoint(
      const std::string& address, const config::Metrics& metrics,
      std::function<std::string()> trouble = [] { return std::string(); });

 private:
  HttpServer server_;
};

}  // namespace iotcloud::rpc
