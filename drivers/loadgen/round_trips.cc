#include <algorithm>
#include <bit>

#include <iotcloud/drivers/loadgen/round_trips.h>

namespace iotcloud::drivers::loadgen {

std::size_t Latencies::bucket(std::uint64_t ns) {
  if (ns < steps) return ns;
  const auto shift = static_cast<std::size_t>(std::bit_width(ns) - std::bit_width(steps));
  return (shift + 1) * steps + ((ns >> shift) - steps);
}

double Latencies::middle_ns(std::size_t bucket) {
  if (bucket < steps) return static_cast<double>(bucket);
  const std::size_t shift = bucket / steps - 1;
  return (static_cast<double>(bucket % steps + steps) + 0.5) * static_cast<double>(std::uint64_t{1} << shift);
}

void Latencies::add(std::chrono::nanoseconds duration) {
  const auto ns = static_cast<std::uint64_t>(std::max<std::int64_t>(0, duration.count()));
  const std::size_t at = bucket(ns);
  if (at >= buckets_.size()) buckets_.resize(at + 1);
  ++buckets_[at];
  ++count_;
  sum_us_ += static_cast<double>(ns) / 1000;
  largest_ns_ = std::max(largest_ns_, ns);
}

double Latencies::quantile_us(double share) const {
  if (count_ == 0) return 0;
  if (share >= 1) return static_cast<double>(largest_ns_) / 1000;
  const auto rank = static_cast<std::uint64_t>(share * static_cast<double>(count_));
  std::uint64_t below = 0;
  for (std::size_t i = 0; i < buckets_.size(); ++i) {
    below += buckets_[i];
    if (below > rank) return std::min(middle_ns(i), static_cast<double>(largest_ns_)) / 1000;
  }
  return static_cast<double>(largest_ns_) / 1000;
}

bool RoundTrips::received(std::uint64_t sequence, std::chrono::nanoseconds latency) {
  if (sequence >= sent_) return false;
  if (seen_.size() < sent_) seen_.resize(std::max<std::size_t>(sent_, 2 * seen_.size()));
  if (sequence + 1 < newest_) furthest_back_ = std::max(furthest_back_, newest_ - 1 - sequence);
  if (seen_[sequence]) {
    ++duplicated_;
    return true;
  }
  seen_[sequence] = true;
  ++received_;
  if (sequence + 1 < newest_) ++out_of_order_;
  newest_ = std::max(newest_, sequence + 1);
  (sequence < warm_up_ ? latencies_of_warm_up_ : latencies_).add(latency);
  return true;
}

}  // namespace iotcloud::drivers::loadgen
