#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <string>

#include <iotcloud/bench/paper/application/load_driver.h>
#include <iotcloud/config/memory.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace {

using namespace iotcloud;

/// Runs the paper's application in one process, on the embedded broker: two gateways with half of the drivers each, and
/// the topology of a YAML file. Prints READY when it takes orders, and ends when its standard input does.
void serve(const std::string& topology, const std::string& folder, int drivers) {
  const drivers::Descriptor load = drivers::describe<bench::paper::LoadDriver>("paper_load", "1.0");
  local::LocalOptions options;
  options.gateways = {discovery::GatewayId("gateway-1"), discovery::GatewayId("gateway-2")};
  options.brokers = {{"embedded", ""}};
  options.drivers = {{"paper_load", &load}};
  local::LocalCluster cluster(options);
  cluster.run_topology(topology);
  for (int driver = 0; driver < drivers; ++driver) {
    cluster.deploy("paper_load", {{"folder", folder}}, options.gateways[static_cast<std::size_t>(driver) % 2]);
  }
  std::printf("READY\n");
  std::fflush(stdout);
  for (std::string line; std::getline(std::cin, line);) {
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: %s TOPOLOGY.yaml FOLDER DRIVERS\n", argv[0]);
    return 2;
  }
  config::keep_freed_memory();  // as the project's daemons do
  try {
    serve(argv[1], argv[2], std::atoi(argv[3]));
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
