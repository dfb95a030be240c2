#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string_view>
#include <thread>

#include <iotcloud/bench/runtime/measure.h>

namespace iotcloud::bench {

namespace {

constexpr const char* usage_text =
    "usage: %s [--dag chain|words|fan|payload] [--tracked] [--rate RESULTS_A_SECOND] [--seconds S] [--warm-up S] "
    "[--threads N] [--sources 1|2] [--numbered] [--births] [--most RESULTS_A_SECOND]\n       %s --print-sentences\n";

std::optional<Options> parse(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view name = argv[i];
    if (bool* const wish = name == "--tracked"    ? &options.tracked
                           : name == "--numbered" ? &options.numbered
                           : name == "--births"   ? &options.births
                                                  : nullptr) {
      *wish = true;
      continue;
    }
    if (i + 1 == argc) return std::nullopt;
    const char* value = argv[++i];
    if (name == "--dag") {
      options.dag_name = value;
    } else if (name == "--rate") {
      options.rate = std::strtod(value, nullptr);
    } else if (name == "--most") {
      options.most = std::strtod(value, nullptr);
    } else if (name == "--seconds") {
      options.seconds = std::strtod(value, nullptr);
    } else if (name == "--warm-up") {
      options.warm_up = std::strtod(value, nullptr);
    } else if (name == "--threads") {
      options.threads = static_cast<unsigned>(std::strtoul(value, nullptr, 10));
    } else if (name == "--sources") {
      options.sources = static_cast<int>(std::strtol(value, nullptr, 10));
    } else {
      return std::nullopt;
    }
  }
  constexpr const char* dags[] = {"chain", "words", "fan", "payload"};
  const auto found = std::find(std::begin(dags), std::end(dags), options.dag_name);
  if (found == std::end(dags) || options.seconds <= 0) return std::nullopt;
  if (options.sources != 1 && (options.sources != 2 || options.rate > 0)) return std::nullopt;
  options.dag = static_cast<Dag>(found - std::begin(dags));
  return options;
}

/// Items that are due within this time come together, as from a network. A source that wakes for each of several
/// million items a second would measure itself.
constexpr double burst_ns = 10'000;
/// A sleeping thread wakes up to 100 us late, so it spins through shorter pauses.
constexpr std::int64_t shortest_sleep_ns = 500'000;

/// Sends every item at the time when it is due, until the feed is stopped.
void send(Engine& engine, Workload& work, std::atomic<std::int64_t>& brought_ns) {
  if (!work.feed.paced()) {
    engine.pump();
    return;
  }
  const auto burst = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(burst_ns / work.feed.interval_ns()));
  for (std::uint64_t next = 0; !work.feed.stopped(); next += burst) {
    const std::int64_t when = work.feed.intended_ns(next);
    if (when - now_ns() > shortest_sleep_ns) {
      sleep_until(when);
    } else {
      while (now_ns() < when) std::this_thread::yield();
    }
    brought_ns.store(now_ns(), std::memory_order_relaxed);
    engine.pump();
  }
  engine.pump();
}

std::uint64_t arrived(const Workload& work) {
  return work.arrivals[0].count() + work.arrivals[1].count();
}

}  // namespace

int measure(const char* engine_name, int argc, char** argv, const MakeEngine& make) {
  if (argc == 2 && argv[1] == std::string_view("--print-sentences")) {
    const Sentences sentences;
    for (std::size_t n = 0; n < sentences.size(); ++n) std::puts(sentences[n].c_str());
    return 0;
  }
  const std::optional<Options> options = parse(argc, argv);
  if (!options) {
    std::fprintf(stderr, usage_text, argv[0], argv[0]);
    return 2;
  }
  Workload work(*options);
  std::atomic<std::int64_t> brought_ns{0};
  if (options->rate > 0) {
    // The clock is read for at most some 200 000 items a second.
    const double items = 1e9 / work.feed.interval_ns();
    const auto every = std::bit_ceil(static_cast<std::uint64_t>(std::max(1.0, items / 200'000)));
    for (Arrivals& arrivals : work.arrivals) arrivals.time(every), arrivals.brought_ns = &brought_ns;
  }
  work.feed.start();
  const std::unique_ptr<Engine> engine = make(work);
  std::thread source([&] { send(*engine, work, brought_ns); });
  const auto pause = [](double seconds) { sleep_until(now_ns() + static_cast<std::int64_t>(seconds * 1e9)); };
  pause(options->warm_up);
  for (Arrivals& arrivals : work.arrivals) arrivals.begin_recording(work.feed.sent());
  const Usage before = Usage::now();
  const double machine_before = machine_cpu_seconds();
  const std::uint64_t first = arrived(work);
  pause(options->seconds);
  const std::uint64_t last = arrived(work);
  const double machine = machine_cpu_seconds() - machine_before;
  const Usage after = Usage::now();
  work.feed.stop();
  source.join();

  const std::int64_t patience = now_ns() + 20'000'000'000;
  const auto expected = [&] { return work.feed.sent() * results_of_item(options->dag); };
  while (arrived(work) < expected() && now_ns() < patience) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  engine->stop();
  if (arrived(work) != expected() || work.wrong > 0) {
    std::fprintf(stderr, "%s, %s: %llu results of %llu arrived, %llu were wrong\n", engine_name,
                 options->dag_name.c_str(), static_cast<unsigned long long>(arrived(work)),
                 static_cast<unsigned long long>(expected()), static_cast<unsigned long long>(work.wrong.load()));
    return 1;
  }

  const double seconds = static_cast<double>(after.at_ns - before.at_ns) * 1e-9;
  const double per_second = static_cast<double>(last - first) / seconds;
  std::printf(
      "{\"engine\":\"%s\",\"dag\":\"%s\",\"tracked\":%s,\"rate\":%.0f,\"per_second\":%.0f,\"ns_per_hop\":%.2f,"
      "\"cpu_percent\":%.2f,\"switches_per_second\":%.0f,\"others_cpu\":%.3f",
      engine_name, options->dag_name.c_str(), options->tracked ? "true" : "false", options->rate, per_second,
      1e9 / per_second / hops_of_result(options->dag), after.cpu_percent_since(before),
      after.switches_per_second_since(before),
      std::max(0.0, (machine - (after.cpu_seconds - before.cpu_seconds)) / seconds));
  if (options->rate > 0) {
    // The latency of the busier last task; when there are two, their items are alike.
    const Arrivals& one = work.arrivals[0].latency.summary().count >= work.arrivals[1].latency.summary().count
                              ? work.arrivals[0]
                              : work.arrivals[1];
    const auto print = [](const char* name, const config::Histogram::Summary& s) {
      std::printf(",\"%s\":{\"p50_us\":%.2f,\"p99_us\":%.2f,\"max_us\":%.2f,\"count\":%llu}", name, s.p50_ns / 1000,
                  s.p99_ns / 1000, s.max_ns / 1000, static_cast<unsigned long long>(s.count));
    };
    print("latency", one.latency.summary());
    print("service", one.service.summary());
  }
  std::printf("}\n");
  return 0;
}

}  // namespace iotcloud::bench
