#include <fmt/format.h>

#include <iotcloud/config/exposure.h>
#include <iotcloud/master/cli/topology/worker_pages.h>
#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::master::cli {

std::string WorkerPages::get(const discovery::WorkerRecord& worker, const std::string& target) {
  if (worker.http.empty()) {
    throw Failed(fmt::format("worker {} serves no pages (it runs inside another program)", worker.name));
  }
  if (worker.tls || worker.host != config::host_name()) return master_.worker_page(topology_, worker.name, target);
  try {
    return rpc::http_get(worker.http, target);
  } catch (const rpc::HttpError& error) {
    throw Failed(fmt::format("worker {}: {}", worker.name, error.what()));
  }
}

}  // namespace iotcloud::master::cli
