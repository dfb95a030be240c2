#include <cstdio>
#include <exception>
#include <map>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <pthread.h>
#include <signal.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace {

/// "key=value" as the properties of a deployment. \throws config::Error.
std::map<std::string, std::string> parse_properties(const std::vector<std::string>& words) {
  std::map<std::string, std::string> properties;
  for (const auto& word : words) {
    const auto equals = word.find('=');
    if (equals == std::string::npos || equals == 0) {
      throw iotcloud::config::Error("--property " + word + ": write it as key=value");
    }
    properties[word.substr(0, equals)] = word.substr(equals + 1);
  }
  return properties;
}

}  // namespace

/// The whole application in one process until SIGTERM or SIGINT: what `./dev demo` runs and measures.
int main(int argc, char** argv) {
  sigset_t stop_signals;
  sigemptyset(&stop_signals);
  sigaddset(&stop_signals, SIGTERM);
  sigaddset(&stop_signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &stop_signals, nullptr);  // before there is another thread
  signal(SIGPIPE, SIG_IGN);

  CLI::App app{"The TurtleBot follower with gateway, master and topology in one process.", "turtlebot-demo"};
  std::string broker_url, plugins, topology, metrics_address;
  std::vector<std::string> properties;
  app.add_option("--plugins", plugins, "folder of turtle.so and turtlebot_follower.so")->required();
  app.add_option("--topology", topology, "the topology's YAML")->required();
  app.add_option("--broker-url", broker_url, "amqp://... of a RabbitMQ (default: the embedded broker)");
  app.add_option("--metrics", metrics_address, "host:port to serve metrics at");
  app.add_option("--property", properties, "key=value for the turtle driver; may be repeated");
  CLI11_PARSE(app, argc, argv);

  try {
    const auto driver_properties = parse_properties(properties);
    std::unique_ptr<iotcloud::config::MetricsEndpoint> metrics;
    if (!metrics_address.empty()) {
      metrics =
          std::make_unique<iotcloud::config::MetricsEndpoint>(metrics_address, iotcloud::config::process_metrics());
    }
    iotcloud::local::LocalOptions options;
    options.name = "demo";
    options.brokers = {{"rabbitmq", broker_url}};
    options.plugin_dir = plugins;
    iotcloud::local::LocalCluster cluster(options);
    cluster.run_topology(topology);
    const auto instance = cluster.deploy("turtle.so", driver_properties);

    int received = 0;
    sigwait(&stop_signals, &received);
    cluster.undeploy(instance);
    return cluster.stop(std::chrono::seconds(5)) ? 0 : 1;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "turtlebot-demo: %s\n", e.what());
    return 1;
  }
}
