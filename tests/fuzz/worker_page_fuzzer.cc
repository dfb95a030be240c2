// The page of a topology's worker, as the command line reads it: bytes of whoever stands in the registry as a worker.
#include <exception>
#include <sstream>
#include <string>

#include "iotcloud/config/exposure.h"
#include "iotcloud/master/cli/topology/topology_pages.h"
#include "iotcloud/tests/fuzz/answering_server.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(worker_page, 1'000) {
  auto& server = fuzz::answering_server();
  server.answer_with("HTTP/1.1 200 OK\r\nContent-Length: " + std::to_string(size) + "\r\n\r\n" +
                     std::string(fuzz::text(data, size)));
  discovery::TopologyStatus topology;
  topology.record.name = discovery::TopologyName("echo");
  for (const auto* name : {"w1", "w2"}) {
    auto& worker = topology.workers.emplace_back();
    worker.name = name;
    worker.host = config::host_name();
    worker.http = "127.0.0.1:" + std::to_string(server.port());
  }
  static master::cli::MasterClient nobody({"127.0.0.1:1"}, {}, std::chrono::milliseconds(1));
  master::cli::WorkerPages workers(nobody, topology.record.name);
  const master::cli::TopologyPages pages(topology, workers);
  fuzz::must(pages.problems().size() + pages.workers() == topology.workers.size(), "a page counts, or says why not");
  std::ostringstream out;
  try {
    pages.brokers();
    pages.troubles();
    auto metrics = pages.metrics();
    master::cli::add_rates(metrics, pages.metrics(), 1);
    master::cli::print_metrics(out, pages, metrics);
  } catch (const std::exception&) {  // NOLINT(bugprone-empty-catch): the command line says what is wrong, and ends
  }
}
