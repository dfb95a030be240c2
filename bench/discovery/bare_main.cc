// Writes a fleet into a registry, and measures how long bare clients take to read it and to declare its queues.
#include <cstdio>
#include <cstring>
#include <exception>

#include <iotcloud/bench/discovery/bare_rabbitmq.h>
#include <iotcloud/bench/discovery/bare_zookeeper.h>
#include <iotcloud/bench/discovery/fleet.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {
namespace {

double seconds_since(std::int64_t begin_ns) {
  return static_cast<double>(now_ns() - begin_ns) / 1e9;
}

void fill(const FleetOptions& options) {
  const Fleet fleet(options);
  BareZooKeeper registry(options.registry);
  std::vector<std::pair<std::string, std::string>> nodes;
  for (const std::string& path : fleet.parents()) nodes.emplace_back(path, "");
  for (int i = 0; i < options.instances; ++i) {
    for (auto& node : fleet.nodes(i)) nodes.push_back(std::move(node));
  }
  const auto begin = now_ns();
  registry.create(nodes);
  std::printf("{\"nodes\": %zu, \"seconds\": %.6f}\n", nodes.size(), seconds_since(begin));
}

/// Reads what a topology needs that wants one channel of each instance, in two rounds: the names, then all records.
void read(const FleetOptions& options) {
  BareZooKeeper registry(options.registry);
  const std::string driver = Fleet(options).parents().back();
  const auto begin = now_ns();
  std::vector<std::string> paths;
  for (const std::string& name : registry.children(driver)) {
    for (const char* record : {"", "/data", "/control"}) paths.push_back(driver + "/" + name + record);
  }
  const std::size_t bytes = registry.read_and_watch(paths);
  std::printf("{\"nodes\": %zu, \"bytes\": %zu, \"seconds\": %.6f}\n", paths.size(), bytes, seconds_since(begin));
}

/// Declares a queue for each topic and a reader for each queue, one request after another.
void declare(const FleetOptions& options) {
  const Fleet fleet(options);
  BareRabbitMq broker(options.broker);
  const int topics = fleet.topics();
  const auto begin = now_ns();
  for (int i = 0; i < topics; ++i) broker.declare(fleet.queue(i, "bare"));
  const double declared = seconds_since(begin);
  for (int i = 0; i < topics; ++i) broker.consume(fleet.queue(i, "bare"));
  std::printf("{\"queues\": %d, \"declare_seconds\": %.6f, \"seconds\": %.6f}\n", topics, declared,
              seconds_since(begin));
}

int run(int argc, char** argv) {
  const char* what = argc > 1 ? argv[1] : "";
  const FleetOptions options = parse_fleet_options(argc - 1, argv + 1);
  if (std::strcmp(what, "fill") == 0) {
    fill(options);
  } else if (std::strcmp(what, "read") == 0) {
    read(options);
  } else if (std::strcmp(what, "declare") == 0) {
    declare(options);
  } else {
    std::fprintf(stderr, "the first word must be fill, read or declare\n");
    return 2;
  }
  return 0;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  try {
    return iotcloud::bench::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
