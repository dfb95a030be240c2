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
  /// \param settings as for HttpServer. \throws Error if it cannot be bound, or may not be served so.
  /// \param metrics must outlive this object.
  /// \param trouble why the daemon is unhealthy; empty if it is healthy. Called on this object's thread.
  MetricsEndpoint(
      const PageSettings& settings, const config::Metrics& metrics,
      std::function<std::string()> trouble = [] { return std::string(); });

  /// As HttpServer::reload().
  void reload() { server_.reload(); }

 private:
  HttpServer server_;
};

}  // namespace iotcloud::rpc
