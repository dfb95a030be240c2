#include <fmt/format.h>

#include <iotcloud/config/exposure.h>
#include <iotcloud/master/cli/topology/worker_pages.h>
#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::master::cli {

std::string WorkerPages::get(const discovery::WorkerRecord& worker, const std::string& target) {
  if (worker.http.empty()) {
    throw RequestFailed(fmt::format("worker {} serves no pages (it runs inside another program)", worker.name));
  }
  if (worker.tls || worker.host != config::host_name()) return master_.worker_page(topology_, worker.name, target);
  if (const auto known = unreachable_.find(worker.name); known != unreachable_.end())
    return by_the_master(worker, target, known->second);
  try {
    return rpc::http_get(worker.http, target);  // without a token, which is not for whoever is in the registry
  } catch (const rpc::HttpUnreachable& error) {
    unreachable_.emplace(worker.name, error.what());
    return by_the_master(worker, target, error.what());
  } catch (const rpc::HttpError& error) {
    throw RequestFailed(fmt::format("worker {}: {}", worker.name, error.what()));
  }
}

std::string WorkerPages::by_the_master(const discovery::WorkerRecord& worker, const std::string& target,
                                       const std::string& why) {
  try {
    return master_.worker_page(topology_, worker.name, target);
  } catch (const RequestFailed& error) {
    throw RequestFailed(
        fmt::format("worker {}: {}; a master does not reach it either: {}", worker.name, why, error.what()));
  }
}

}  // namespace iotcloud::master::cli
