#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include <iotcloud/bench/harness/latency_histogram.h>
#include <iotcloud/bench/paper/application/order.h>

namespace iotcloud::bench::paper {

/// What becomes of one order in this process. Thread safe.
class Point {
 public:
  explicit Point(const Order& order) : order_(order) {}
  const Order& order() const { return order_; }

  /// A driver takes part, and will send so many messages.
  void joined(std::uint64_t messages);
  void sent();
  /// A message came back for the first time, whole and in order. \param now_ns when.
  void came_back(std::int64_t intended_ns, std::int64_t now_ns);
  /// It came out of order, twice or changed.
  void wrong() { wrong_.fetch_add(1, std::memory_order_relaxed); }

  /// So much is under way that the rest is not sent: before the broker's memory is full.
  bool overrun() const { return overrun_; }
  /// All messages of `drivers` drivers came back; or what was sent of them did, after an overrun.
  bool complete(std::uint64_t drivers) const;
  /// As JSON, with the histogram: hosts are added up by who asked for it.
  std::string report() const;

 private:
  const Order order_;
  std::atomic<std::uint64_t> drivers_ = 0, planned_ = 0, sent_ = 0, came_back_ = 0, wrong_ = 0;
  std::atomic<std::uint64_t> in_time_ = 0;  ///< came back between from_ns and until_ns
  std::atomic<bool> overrun_ = false;
  LatencyHistogram latency_;
};

}  // namespace iotcloud::bench::paper
