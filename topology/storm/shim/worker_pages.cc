#include <map>
#include <string>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/topology/storm/shim/worker_pages.h>

namespace iotcloud::topology::storm {

namespace {

constexpr config::Logger pages_logger{"topology.storm"};

}  // namespace

WorkerPages::WorkerPages(const rpc::PageSettings& settings) {
  if (settings.address.empty()) return;
  const bool any_port = settings.address.ends_with(":0");
  rpc::PageSettings own = settings;
  for (int tried = 0; !server_; ++tried) {
    if (!any_port) {
      const auto first = rpc::split_address(settings.address);
      own.address = first.host + ":" + std::to_string(first.port + tried);
    }
    try {
      server_.emplace(
          own, std::map<std::string, rpc::HttpHandler>{{"/metrics", rpc::metrics_page(config::process_metrics())}});
    } catch (const config::Error&) {
      if (any_port || tried + 1 == ports_of_a_machine) throw;
    }
  }
  pages_logger.info("metrics of this worker: http{}://{}/metrics", settings.tls.empty() ? "" : "s", address());
}

}  // namespace iotcloud::topology::storm
