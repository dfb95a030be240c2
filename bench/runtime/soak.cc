// A long run at most of the runtime's capacity, with random disturbances. Prints progress to stderr and figures as
// lines of JSON to stdout. Exit status 1: a tuple is not accounted for, a key was out of order, or memory grew.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/bench/runtime/soak_run.h>

namespace iotcloud::bench {

namespace {

using std::chrono::milliseconds;
constexpr double load = 0.8;

/// The rate that it reaches undisturbed and unlimited.
double saturation_rate() {
  SoakOptions options;
  options.length = milliseconds(4000);
  options.longest_calm = milliseconds(0);
  Soak soak(options);
  std::uint64_t first = 0, last = 0;
  std::int64_t first_ns = 0, last_ns = 0;
  soak.run([&](const SoakCounts& counts, milliseconds) {
    last = counts.acked + counts.failed, last_ns = now_ns();
    if (first_ns == 0) first = last, first_ns = last_ns;
  });
  return last_ns == first_ns ? 0 : static_cast<double>(last - first) / (static_cast<double>(last_ns - first_ns) * 1e-9);
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

/// The growth from the second quarter's memory to the last quarter's; the first quarter is the warm-up.
double growth_mb(const std::vector<double>& samples) {
  const auto quarter = static_cast<std::ptrdiff_t>(samples.size() / 4);
  const auto part = [&](std::ptrdiff_t n) {
    return median({samples.begin() + n * quarter, samples.begin() + (n + 1) * quarter});
  };
  return quarter == 0 ? 0 : part(3) - part(1);
}

/// \param at_most negative: no limit.
void print(const char* figure, const char* unit, double value, double at_most = -1) {
  std::printf("{\"figure\":\"%s\",\"unit\":\"%s\",\"value\":%.15g", figure, unit, value);
  if (at_most >= 0) std::printf(",\"at_most\":%.9g", at_most);
  std::printf("}\n");
}

int run(double minutes, std::uint64_t seed) {
  constexpr double allowed_growth_mb = 8;
  std::fprintf(stderr, "measuring what it reaches undisturbed (4 s); seed %llu\n",
               static_cast<unsigned long long>(seed));
  const double most = saturation_rate();
  SoakOptions options;
  options.rate = load * most;
  options.length = milliseconds(static_cast<std::int64_t>(minutes * 60'000));
  options.seed = seed;
  std::fprintf(stderr, "%.2f M tuples/s; now %.2f M/s for %.1f minutes\n", most / 1e6, options.rate / 1e6, minutes);
  Soak soak(options);
  std::vector<double> memory_mb;
  const std::int64_t began = now_ns();
  soak.run([&](const SoakCounts& c, milliseconds left) {
    memory_mb.push_back(static_cast<double>(resident_bytes()) / 1e6);
    if (memory_mb.size() % 10 != 0) return;
    std::fprintf(stderr,
                 "%5lld s left: %llu M emitted, %llu under way, %llu failed, %llu out of order, "
                 "%llu rebalances, %llu pauses, %.0f MB\n",
                 static_cast<long long>(left.count() / 1000), static_cast<unsigned long long>(c.emitted / 1'000'000),
                 static_cast<unsigned long long>(c.emitted - std::min(c.emitted, c.acked + c.failed)),
                 static_cast<unsigned long long>(c.failed), static_cast<unsigned long long>(c.out_of_order),
                 static_cast<unsigned long long>(c.rebalances), static_cast<unsigned long long>(c.pauses),
                 memory_mb.back());
  });
  const double seconds = static_cast<double>(now_ns() - began) * 1e-9;
  const SoakCounts c = soak.counts();
  std::vector<std::string> violations = soak.violations();
  const double growth = growth_mb(memory_mb);
  if (growth > allowed_growth_mb) violations.push_back("memory grew by " + std::to_string(growth) + " MB");

  print("undisturbed, at most", "M tuples/s", most / 1e6);
  print("disturbed, mean with pauses", "M tuples/s", static_cast<double>(c.acked + c.failed) / seconds / 1e6);
  print("emitted", "tuples", static_cast<double>(c.emitted));
  print("acked", "tuples", static_cast<double>(c.acked));
  print("failed on purpose", "tuples", static_cast<double>(c.refused));
  print("not accounted for", "tuples", static_cast<double>(c.emitted) - static_cast<double>(c.acked + c.failed), 0);
  print("out of order", "tuples", static_cast<double>(c.out_of_order), 0);
  print("rebalances", "", static_cast<double>(c.rebalances));
  print("pauses", "", static_cast<double>(c.pauses));
  print("memory at the end", "MB", memory_mb.empty() ? 0 : memory_mb.back());
  print("memory growth", "MB", growth, allowed_growth_mb);
  for (const std::string& violation : violations) std::fprintf(stderr, "VIOLATION: %s\n", violation.c_str());
  return violations.empty() ? 0 : 1;
}

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  double minutes = 10;
  std::uint64_t seed = std::random_device{}();
  bool understood = argc % 2 == 1;
  for (int i = 1; understood && i + 1 < argc; i += 2) {
    if (std::strcmp(argv[i], "--minutes") == 0) {
      minutes = std::strtod(argv[i + 1], nullptr);
    } else if (std::strcmp(argv[i], "--seed") == 0) {
      seed = std::strtoull(argv[i + 1], nullptr, 10);
    } else {
      understood = false;
    }
  }
  if (!understood || minutes <= 0) {
    std::fprintf(stderr, "usage: %s [--minutes N] [--seed N]\n", argv[0]);
    return 2;
  }
  return iotcloud::bench::run(minutes, seed);
}
