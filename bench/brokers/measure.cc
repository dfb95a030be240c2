#include <cstdio>
#include <exception>

#include <iotcloud/bench/brokers/client.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

namespace {

constexpr std::int64_t second_ns = 1'000'000'000;
constexpr std::int64_t look_every_ns = second_ns / 20;
constexpr std::int64_t patience_ns = 20 * second_ns;
/// A load that exceeds the broker's capacity is aborted before the broker's memory is full.
constexpr std::uint64_t most_bytes_under_way = 256 << 20;
constexpr std::uint64_t most_under_way = 50'000;

struct Snapshot {
  Usage own = Usage::now();
  double server, processors, machine;
  explicit Snapshot(const BrokerOptions& options) : server(0), processors(0), machine(machine_cpu_seconds()) {
    for (const pid_t process : options.server) server += cpu_seconds_of(process);
    for (const pid_t process : options.processors) processors += cpu_seconds_of(process);
  }
};

bool overrun(const BrokerOptions& options, const Load& load) {
  const std::uint64_t under_way = load.sent() - load.came_back();
  return options.rate > 0 && (under_way * options.size > most_bytes_under_way || under_way > most_under_way);
}

/// \return false when the load was aborted.
bool wait(const BrokerOptions& options, const Load& load, double seconds) {
  const std::int64_t end = now_ns() + static_cast<std::int64_t>(seconds * second_ns);
  while (now_ns() < end) {
    if (overrun(options, load)) return false;
    sleep_until(std::min(end, now_ns() + look_every_ns));
  }
  return true;
}

void print(const char* engine, const Load& load, const Snapshot& before, const Snapshot& after, bool sustained) {
  const double seconds = static_cast<double>(after.own.at_ns - before.own.at_ns) / second_ns;
  const double own = after.own.cpu_seconds - before.own.cpu_seconds;
  const double server = after.server - before.server, processors = after.processors - before.processors;
  const double others = after.machine - before.machine - own - server - processors;
  const LatencyHistogram::Summary latency = load.latency();
  std::printf(
      "{\"engine\":\"%s\",\"sustained\":%s,\"count\":%llu,\"lost\":%llu,\"per_second\":%.1f,\"mean_us\":%.2f,"
      "\"stddev_us\":%.2f,\"p50_us\":%.1f,\"p99_us\":%.1f,\"max_us\":%.1f,\"cpu_seconds\":%.4f,"
      "\"server_cpu_seconds\":%.4f,\"processor_cpu_seconds\":%.4f,\"others_cpu\":%.3f,\"switches\":%lld,"
      "\"seconds\":%.3f}\n",
      engine, sustained ? "true" : "false", static_cast<unsigned long long>(latency.count),
      static_cast<unsigned long long>(load.sent() - load.came_back()), static_cast<double>(latency.count) / seconds,
      latency.mean_us, latency.stddev_us, latency.p50_us, latency.p99_us, latency.max_us, own, server, processors,
      std::max(0.0, others / seconds), static_cast<long long>(after.own.switches - before.own.switches), seconds);
}

int run(const char* engine, const BrokerOptions& options, const MakeClient& make) {
  Load load(options);
  const std::unique_ptr<Client> client = make(options, load);
  client->connect();
  load.begin();
  if (!options.idle) client->begin();
  bool sustained = wait(options, load, options.warm_up);
  const Snapshot before(options);
  load.begin_recording();
  if (sustained) sustained = wait(options, load, options.seconds);
  load.end_recording();
  const Snapshot after(options);
  load.stop();
  const std::int64_t limit = now_ns() + patience_ns;
  // Messages that were sent in time may still arrive; an aborted load has many of them.
  while (load.came_back() < load.sent() && now_ns() < limit) sleep_until(now_ns() + second_ns / 1000);
  const bool complete = load.came_back() == load.sent() && load.wrong() == 0;
  if (!complete) {
    std::fprintf(stderr, "%s: %llu of %llu messages came back, %llu out of order or changed\n", engine,
                 static_cast<unsigned long long>(load.came_back()), static_cast<unsigned long long>(load.sent()),
                 static_cast<unsigned long long>(load.wrong()));
  }
  client->stop();
  if (complete) print(engine, load, before, after, sustained);
  return complete ? 0 : 1;
}

}  // namespace

int measure_client(const char* engine, int argc, char** argv, const MakeClient& make) {
  const std::optional<BrokerOptions> options = parse_broker_options(argc, argv);
  if (!options) return 2;
  try {
    return run(engine, *options, make);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", engine, error.what());
    return 1;
  }
}

}  // namespace iotcloud::bench
