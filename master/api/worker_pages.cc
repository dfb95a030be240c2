#include <string_view>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/api/worker_pages.h>
#include <iotcloud/master/gateways/site_client.h>
#include <iotcloud/master/master.h>
#include <iotcloud/rpc/http/http_client.h>
#include <iotcloud/rpc/listen_settings.h>

namespace iotcloud::master {

namespace {

/// Of an answer; a page with thousands of tasks is smaller.
constexpr std::size_t largest_page = 8U << 20U;
constexpr std::size_t longest_target = 2'000;

/// \throws config::Error unless the target is a page that is read here. It has only the characters of an encoded query,
/// so that nobody puts a header or another request behind it.
void check_target(const std::string& target) {
  constexpr std::string_view of_a_query = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_.~%=&";
  if (target == "/topology" || target == "/units") return;
  for (const std::string_view page : {"/tap?", "/trace?"}) {
    if (target.starts_with(page) && target.size() <= longest_target &&
        target.find_first_not_of(of_a_query, page.size()) == std::string::npos) {
      return;
    }
  }
  throw config::Error(
      fmt::format("a worker's page \"{}\" is not read here; there are /topology, /units, /tap?... and "
                  "/trace?...",
                  target.substr(0, longest_target)));
}

discovery::WorkerRecord find_worker(const Master& master, const discovery::TopologyName& topology,
                                    const std::string& worker) {
  for (const auto& one : master.topologies()) {
    if (one.record.name != topology) continue;
    for (const auto& found : one.workers) {
      if (found.name == worker) return found;
    }
    throw config::Error(fmt::format("topology {} has no worker {}; it has ended", topology, worker));
  }
  throw config::Error(fmt::format("no topology \"{}\"", topology));
}

/// \throws config::Error when this master cannot reach the worker's pages.
void check_reachable(const discovery::WorkerRecord& worker) {
  if (worker.http.empty()) {
    throw config::Error(fmt::format("worker {} serves no pages (it runs inside another program)", worker.name));
  }
  // On loopback of another machine's record, something else may answer here.
  const bool is_here = worker.host == config::host_name();
  const bool on_loopback = config::is_loopback(rpc::split_address(worker.http).host);
  if (worker.tls ? is_here || !on_loopback : is_here && on_loopback) return;
  throw config::Error(
      fmt::format("worker {} is on {} and shows its pages there only; to be seen from elsewhere its YAML needs "
                  "metrics: {{address, tls, tokens}}",
                  worker.name, worker.host));
}

/// Whether it is the page /topology of that worker.
bool is_page_of(const std::string& text, const discovery::WorkerRecord& worker) {
  try {
    const auto page = discovery::parse_json(text, "its page", largest_page);
    return page.is_object() && page.value("worker", "") == worker.name;
  } catch (const std::exception&) {
    return false;  // it is no JSON, or of another kind
  }
}

/// A page of a worker that shows its pages on this machine only, without TLS. Its record may come from anybody who may
/// write a worker's, and name any port: no answer but that worker's own is passed on. \throws HttpError
std::string read_here(const discovery::WorkerRecord& worker, const std::string& target) {
  const rpc::HttpReader reader{.tls = {}, .token = {}, .largest_page = largest_page};
  const std::string overview = "/topology";
  std::string page;
  try {
    page = rpc::http_get(worker.http, overview, reader);
  } catch (const rpc::HttpUnreachable&) {
    throw;
  } catch (const rpc::HttpError&) {
    page.clear();  // what the error says may be another program's
  }
  if (!is_page_of(page, worker)) throw rpc::HttpError("another program answers at " + worker.http);
  return target == overview ? page : rpc::http_get(worker.http, target, reader);
}

/// How this master reads workers' pages. \throws config::Error when it cannot.
rpc::HttpReader reader_with(const WorkerAccess& access) {
  if (access.tls.empty()) {
    throw config::Error(
        "the pages of workers take TLS, and this master has no certificate; give it one (api: {tls: {ca, certificate, "
        "key}})");
  }
  if (access.token_file.empty()) {
    throw config::Error(
        "the pages of workers take a token, and this master has none; give it one (api: {worker_token_file})");
  }
  return {access.tls, token_in(access.token_file), largest_page};
}

}  // namespace

std::string read_worker_page(const Master& master, const WorkerAccess& access, const discovery::TopologyName& topology,
                             const std::string& worker, const std::string& target) {
  check_target(target);
  const auto record = find_worker(master, topology, worker);
  check_reachable(record);
  try {
    return record.tls ? rpc::http_get(record.http, target, reader_with(access)) : read_here(record, target);
  } catch (const rpc::HttpError& error) {
    throw config::Error(fmt::format("worker {}: {}", worker, error.what()));
  }
}

}  // namespace iotcloud::master
