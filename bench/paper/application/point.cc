#include <nlohmann/json.hpp>

#include <iotcloud/bench/paper/application/point.h>

namespace iotcloud::bench::paper {

namespace {

/// For one host; the bare clients have the same limits (bench/brokers/measure.cc).
constexpr std::uint64_t most_bytes_under_way = 128 << 20;
constexpr std::uint64_t most_under_way = 25'000;

}  // namespace

void Point::joined(std::uint64_t messages) {
  planned_ += messages;
  ++drivers_;
}

void Point::came_back(std::int64_t intended_ns, std::int64_t now_ns) {
  came_back_.fetch_add(1, std::memory_order_relaxed);
  if (intended_ns >= order_.from_ns) latency_.record_ns(now_ns - intended_ns);
  if (now_ns >= order_.from_ns && now_ns < order_.until_ns) in_time_.fetch_add(1, std::memory_order_relaxed);
}

void Point::sent() {
  const std::uint64_t under_way = ++sent_ - came_back_;
  if (under_way > most_under_way || under_way * order_.size > most_bytes_under_way) overrun_ = true;
}

bool Point::complete(std::uint64_t drivers) const {
  return drivers_ == drivers && sent_ == came_back_ && (sent_ == planned_ || overrun_);
}

std::string Point::report() const {
  const LatencyHistogram::Summary latency = latency_.summary();
  return nlohmann::ordered_json{{"order", order_.id},
                                {"drivers", drivers_.load()},
                                {"planned", planned_.load()},
                                {"sent", sent_.load()},
                                {"came_back", came_back_.load()},
                                {"wrong", wrong_.load()},
                                {"in_time", in_time_.load()},
                                {"overrun", overrun_.load()},
                                {"n", latency.count},
                                {"mean_us", latency.mean_us},
                                {"stddev_us", latency.stddev_us},
                                {"max_us", latency.max_us},
                                {"histogram_us", latency_.counts()}}
      .dump();
}

}  // namespace iotcloud::bench::paper
