// Measures a topology that reads a large fleet and sends to it: when it is ready, its costs at rest, and how soon it
// reads a new driver.
#include <algorithm>
#include <cstdio>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>

#include <fmt/core.h>
#include <unistd.h>

#include <iotcloud/bench/discovery/bare_rabbitmq.h>
#include <iotcloud/bench/discovery/bare_zookeeper.h>
#include <iotcloud/bench/discovery/fleet.h>
#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/config/log.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::bench {
namespace {

constexpr std::int64_t ms = 1'000'000;
constexpr std::int64_t limit_ns = 300'000 * ms;
constexpr const char* topology_name = "bench";

void wait_for(const char* what, std::int64_t pause_ns, const std::function<bool()>& condition) {
  const std::int64_t begin = now_ns();
  while (!condition()) {
    if (now_ns() - begin > limit_ns) throw std::runtime_error(std::string("waited in vain for ") + what);
    sleep_until(now_ns() + pause_ns);
  }
}

class Run {
 public:
  explicit Run(const FleetOptions& options) : options_(options), fleet_(options) {
    discovery::RegistryOptions registry;
    registry.url = options.registry;
    gateway_ = discovery::make_registry(registry);
    if (options.registry.starts_with("embedded:")) fill();
    if (options.broker.starts_with("amqp")) broker_.emplace(options.broker);
  }

  void run() {
    const std::string yaml = fmt::format(
        "registry: \"{}\"\ntopology.name: {}\nbrokers: {{broker: \"{}\"}}\n"
        "spouts: {{in: {{broker: broker, driver: {}, channel: data, fields: [data, driverID, time]}}}}\n"
        "bolts: {{out: {{broker: broker, driver: {}, channel: control, fields: [data, driverID, time], "
        "inputs: [{{from: in, grouping: fields, fields: [driverID]}}]}}}}\n",
        options_.registry, topology_name, options_.broker, Fleet::driver, Fleet::driver);
    topology::Worker worker({.definition = topology::TopologyDefinition::parse(yaml, "bench"),
                             .components = {},
                             .library_folders = {},
                             .registry = nullptr,
                             .clock = nullptr,
                             .metrics = &metrics_,
                             .on_killed = {}});
    const Usage before = Usage::now();
    const double server_before = server_cpu();
    const ServerCounts asked_before = counts();
    worker.start();
    wait_for("the readers", 5 * ms, [&] { return readers() >= fleet_.topics(); });
    const double opened = seconds_since(before.at_ns);
    const ServerCounts asked = counts();
    check_all_are_read();
    const Usage ready = Usage::now();
    const double server_ready = server_cpu();
    const double server_cost = server_ready - server_before;
    std::printf(
        "{\"figure\": \"ready\", \"opened_seconds\": %.6f, \"seconds\": %.6f, \"cpu_seconds\": %.3f, "
        "\"server_cpu_seconds\": %.3f, \"topics\": %d, \"resident_mb\": %.1f, \"requests\": %.0f, \"writes\": %.0f}\n",
        opened, seconds_since(before.at_ns), ready.cpu_seconds - before.cpu_seconds, server_cost, fleet_.topics(),
        static_cast<double>(resident_bytes()) / 1e6, static_cast<double>(asked.requests - asked_before.requests),
        static_cast<double>(asked.writes - asked_before.writes));
    std::fflush(stdout);
    rest();
    newcomers();
    worker.stop(std::chrono::seconds(5));
  }

 private:
  static double seconds_since(std::int64_t begin) { return static_cast<double>(now_ns() - begin) / 1e9; }

  void fill() {
    for (int i = 0; i < options_.instances; ++i) appear(i);
  }

  void appear(int instance) {
    for (const auto& [path, data] : fleet_.nodes(instance)) gateway_->create(path, data);
  }

  /// Readers that the topology has opened, according to its metrics.
  int readers() {
    return static_cast<int>(metrics_
                                .gauge("iotcloud_spout_channels", "Channels that this worker reads",
                                       {{"topology", topology_name}, {"component", "in"}})
                                .value());
  }

  bool is_read(int instance) { return !broker_ || broker_->readers(fleet_.queue(instance, topology_name)) > 0; }

  /// Asks the broker itself, so its unfinished work counts; the question takes time, which counts, too.
  void check_all_are_read() {
    if (!broker_) return;
    for (int i = 0; i < fleet_.topics(); ++i) {
      wait_for("a queue's reader", ms, [&] { return is_read(i); });
    }
  }

  /// Empty for the embedded registry.
  ServerCounts counts() const {
    return options_.registry.starts_with("zookeeper:") ? counts_of(options_.registry) : ServerCounts();
  }

  double server_cpu() const {
    double all = 0;
    for (const pid_t process : options_.server) all += cpu_seconds_of(process);
    return all;
  }

  /// Sum over all threads of this process and of the servers.
  double waited_seconds() const {
    double all = waited_seconds_of(getpid());
    for (const pid_t process : options_.server) all += waited_seconds_of(process);
    return all;
  }

  void rest() {
    sleep_until(now_ns() + 2000 * ms);  // lets the system settle
    const Usage before = Usage::now();
    const double server = server_cpu();
    sleep_until(before.at_ns + static_cast<std::int64_t>(options_.rest * 1e9));
    const Usage after = Usage::now();
    std::printf("{\"figure\": \"rest\", \"cpu_percent\": %.4f, \"server_cpu_percent\": %.4f, \"switches\": %.1f}\n",
                after.cpu_percent_since(before), 100 * (server_cpu() - server) / options_.rest,
                after.switches_per_second_since(before));
    std::fflush(stdout);
  }

  /// Adds one driver at a time, and measures from the moment when its nodes are in the registry until the broker has a
  /// reader for it. It asks the broker no earlier than a reader can exist, so that the broker has nothing else to do.
  void newcomers() {
    struct Newcomer {
      double took_ms, waited_ms;
      bool operator<(const Newcomer& other) const { return took_ms < other.took_ms; }
    };
    std::vector<Newcomer> all;
    const ServerCounts asked_before = counts();
    const double server_before = server_cpu();
    const double machine_before = machine_cpu_seconds();
    const Usage before = Usage::now();
    for (int i = options_.instances; i < options_.instances + options_.fresh; ++i) {
      const int expected = readers() + 1;
      const double waited = waited_seconds();
      appear(i);
      const std::int64_t begin = now_ns();
      wait_for("a new driver's reader", ms / 2, [&] { return readers() >= expected && is_read(i); });
      const double took = seconds_since(begin);
      all.push_back({1000 * took, 1000 * (waited_seconds() - waited)});
    }
    if (all.empty()) return;
    const double each = 1 / static_cast<double>(all.size());
    const Usage after = Usage::now();
    const double own = after.cpu_seconds - before.cpu_seconds;
    const double others = machine_cpu_seconds() - machine_before - (server_cpu() - server_before) - own;
    const ServerCounts asked = counts();
    std::sort(all.begin(), all.end());
    const auto quantile = [&](double q) {
      return all[std::min(all.size() - 1, static_cast<std::size_t>(q * static_cast<double>(all.size())))];
    };
    std::printf(
        "{\"figure\": \"new\", \"count\": %zu, \"p50_ms\": %.3f, \"p99_ms\": %.3f, \"max_ms\": %.3f, "
        "\"p99_waited_ms\": %.1f, \"others_cpu\": %.3f, \"cpu_ms_each\": %.3f, \"requests_each\": %.2f, "
        "\"writes_each\": %.2f}\n",
        all.size(), quantile(0.5).took_ms, quantile(0.99).took_ms, all.back().took_ms, quantile(0.99).waited_ms,
        std::max(0.0, others / (static_cast<double>(after.at_ns - before.at_ns) * 1e-9)), 1000 * each * own,
        each * static_cast<double>(asked.requests - asked_before.requests),
        each * static_cast<double>(asked.writes - asked_before.writes));
    std::fflush(stdout);
  }

  const FleetOptions options_;
  const Fleet fleet_;
  config::Metrics metrics_;
  std::unique_ptr<discovery::Registry> gateway_;  ///< writes the records of new drivers
  std::optional<BareRabbitMq> broker_;            ///< is asked for readers; none: the metrics are used
};

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  try {
    iotcloud::config::set_log_level(iotcloud::config::LogLevel::warn);
    iotcloud::bench::Run(iotcloud::bench::parse_fleet_options(argc, argv)).run();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
