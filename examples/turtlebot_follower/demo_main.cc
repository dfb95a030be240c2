#include <algorithm>
#include <cstdio>
#include <exception>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <pthread.h>
#include <signal.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/examples/turtlebot_follower/view.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace {

struct Robot {
  iotcloud::discovery::GatewayId gateway;
  std::map<std::string, std::string> properties;
};

/// Parses "gateway-1 key=value ...". \throws config::Error.
Robot parse_robot(const std::vector<std::string>& words) {
  Robot robot{iotcloud::discovery::GatewayId(words.at(0)), {}};
  if (robot.gateway.str().find('=') != std::string::npos) {
    throw iotcloud::config::Error("--robot " + robot.gateway +
                                  ": name its gateway first, as in --robot gateway-1 seed=1");
  }
  for (auto word = words.begin() + 1; word != words.end(); ++word) {
    const auto equals = word->find('=');
    if (equals == std::string::npos || equals == 0) {
      throw iotcloud::config::Error("--robot " + robot.gateway + " " + *word + ": write it as key=value");
    }
    robot.properties[word->substr(0, equals)] = word->substr(equals + 1);
  }
  return robot;
}

/// Each gateway once, in the order of the robots.
std::vector<iotcloud::discovery::GatewayId> gateways_of(const std::vector<Robot>& fleet) {
  std::vector<iotcloud::discovery::GatewayId> gateways;
  for (const auto& robot : fleet) {
    if (std::find(gateways.begin(), gateways.end(), robot.gateway) == gateways.end()) {
      gateways.push_back(robot.gateway);
    }
  }
  return gateways;
}

/// Writes how long the bolts' tasks took so far, a line for each: component, p50 and p99 of execute() in ms.
/// \throws config::Error.
void write_times(const std::string& file) {
  std::ofstream out(file);
  for (const auto& sample : iotcloud::config::process_metrics().collect()) {
    if (sample.name != "iotcloud_task_execute_seconds" || sample.histogram.count == 0) continue;
    out << sample.labels.at("component") << '\t' << sample.histogram.p50_ns / 1e6 << '\t'
        << sample.histogram.p99_ns / 1e6 << '\n';
  }
  out.close();
  if (!out) throw iotcloud::config::Error("--times " + file + ": it cannot be written; is its folder there?");
}

}  // namespace

/// Runs the whole application in one process until SIGTERM or SIGINT; `./dev demo` starts and measures it.
int main(int argc, char** argv) {
  sigset_t stop_signals;
  sigemptyset(&stop_signals);
  sigaddset(&stop_signals, SIGTERM);
  sigaddset(&stop_signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &stop_signals, nullptr);  // before any other thread starts
  signal(SIGPIPE, SIG_IGN);

  CLI::App app{"The TurtleBot follower with gateway, master and topology in one process.", "turtlebot-demo"};
  std::string broker_url, plugins, topology, times, view;
  std::vector<std::string> pages;
  std::vector<std::vector<std::string>> robots;
  app.add_option("--plugins", plugins, "folder of turtle.so and turtlebot_follower.so")->required();
  app.add_option("--topology", topology, "the topology's YAML")->required();
  app.add_option("--broker-url", broker_url,
                 "amqp://, kafka:// or activemq://... of a server (default: the embedded broker)");
  app.add_option("--times", times, "file that gets p50 and p99 of each bolt in ms, at the end");
  app.add_option("--view", view, "HOST:PORT of loopback, where a page shows all of it; its address is printed");
  app.add_option("--pages", pages, "folder of robots' pages for --view")->allow_extra_args(false);
  app.add_option("--robot", robots,
                 "GATEWAY [key=value ...]: a turtle there, with these properties; once for each robot (default: one)");
  CLI11_PARSE(app, argc, argv);

  try {
    if (robots.empty()) robots = {{"gateway-1"}};
    std::vector<Robot> fleet;
    fleet.reserve(robots.size());
    for (const auto& words : robots) fleet.push_back(parse_robot(words));
    iotcloud::local::LocalOptions options;
    options.name = "demo";
    options.brokers = {{"rabbitmq", broker_url}};
    options.plugin_dir = plugins;
    options.gateways = gateways_of(fleet);
    iotcloud::local::LocalCluster cluster(options);
    cluster.run_topology(topology);
    std::vector<iotcloud::discovery::InstanceId> instances;
    instances.reserve(fleet.size());
    for (const auto& [gateway, properties] : fleet) {
      instances.push_back(cluster.deploy("turtle.so", properties, gateway));
    }

    auto page = view.empty() ? nullptr : show(cluster, view, pages);
    if (page) {
      std::printf("%s\n", page->url().c_str());
      std::fflush(stdout);
    }
    int received = 0;
    sigwait(&stop_signals, &received);
    page.reset();
    if (!times.empty()) write_times(times);
    for (const auto& instance : instances) cluster.undeploy(instance);
    return cluster.stop(std::chrono::seconds(5)) ? 0 : 1;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "turtlebot-demo: %s\n", e.what());
    return 1;
  }
}
