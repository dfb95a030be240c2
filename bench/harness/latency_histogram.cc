#include <algorithm>
#include <bit>
#include <cmath>

#include <iotcloud/bench/harness/latency_histogram.h>

namespace iotcloud::bench {

std::size_t LatencyHistogram::bucket(std::uint64_t ns) {
  if (ns < steps) return ns;
  const auto shift = static_cast<std::size_t>(std::bit_width(ns) - std::bit_width(steps));
  return std::min((shift + 1) * steps + ((ns >> shift) - steps), steps * octaves - 1);
}

double LatencyHistogram::middle_us(std::size_t bucket) {
  if (bucket < steps) return static_cast<double>(bucket) / 1000;
  const std::size_t shift = bucket / steps - 1;
  return (static_cast<double>(bucket % steps + steps) + 0.5) * static_cast<double>(std::uint64_t{1} << shift) / 1000;
}

void LatencyHistogram::record_ns(std::int64_t ns) {
  ns = std::max<std::int64_t>(ns, 0);
  buckets_[bucket(static_cast<std::uint64_t>(ns))].fetch_add(1, std::memory_order_relaxed);
  const double us = static_cast<double>(ns) / 1000;
  sum_us_.fetch_add(us, std::memory_order_relaxed);
  squares_us_.fetch_add(us * us, std::memory_order_relaxed);
  std::int64_t largest = largest_ns_.load(std::memory_order_relaxed);
  while (largest < ns && !largest_ns_.compare_exchange_weak(largest, ns, std::memory_order_relaxed)) {
  }
}

double LatencyHistogram::quantile_us(double share, std::uint64_t count) const {
  const auto rank = static_cast<std::uint64_t>(share * static_cast<double>(count));
  std::uint64_t below = 0;
  for (std::size_t i = 0; i < buckets_.size(); ++i) {
    below += buckets_[i];
    if (below > rank) return std::min(middle_us(i), static_cast<double>(largest_ns_) / 1000);
  }
  return static_cast<double>(largest_ns_) / 1000;
}

LatencyHistogram::Summary LatencyHistogram::summary() const {
  Summary summary;
  for (const auto& bucket : buckets_) summary.count += bucket;
  if (summary.count == 0) return summary;
  const auto count = static_cast<double>(summary.count);
  summary.mean_us = sum_us_ / count;
  summary.stddev_us = std::sqrt(std::max(0.0, squares_us_ / count - summary.mean_us * summary.mean_us));
  summary.p50_us = quantile_us(0.5, summary.count);
  summary.p99_us = quantile_us(0.99, summary.count);
  summary.max_us = static_cast<double>(largest_ns_) / 1000;
  return summary;
}

std::vector<std::pair<double, std::uint64_t>> LatencyHistogram::counts() const {
  std::vector<std::pair<double, std::uint64_t>> found;
  for (std::size_t i = 0; i < buckets_.size(); ++i) {
    if (buckets_[i] != 0) found.emplace_back(middle_us(i), buckets_[i]);
  }
  return found;
}

}  // namespace iotcloud::bench
