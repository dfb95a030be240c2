#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include <iotcloud/bench/harness/latency_histogram.h>
#include <iotcloud/bench/paper/application/order.h>

namespace iotcloud::bench::paper {

/// Counts the outcome of one order in this process. Thread safe.
class Point {
 public:
  explicit Point(const Order& order) : order_(order) {}
  const Order& order() const { return order_; }

  /// Adds a driver, which will send this many messages.
  void joined(std::uint64_t messages);
  void sent();
  /// Counts a message that came back for the first time, unchanged and in order. \param now_ns when.
  void came_back(std::int64_t intended_ns, std::int64_t now_ns);
  /// Counts a message that came back out of order, twice or changed.
  void wrong() { wrong_.fetch_add(1, std::memory_order_relaxed); }

  /// Whether so many messages are under way that the rest must not be sent, before the broker's memory is full.
  bool overrun() const { return overrun_; }
  /// Whether all messages of `drivers` drivers came back; after an overrun, all that were sent.
  bool complete(std::uint64_t drivers) const;
  /// The counts as JSON, with the histogram; the reader adds up the hosts.
  std::string report() const;

 private:
  const Order order_;
  std::atomic<std::uint64_t> drivers_ = 0, planned_ = 0, sent_ = 0, came_back_ = 0, wrong_ = 0;
  std::atomic<std::uint64_t> in_time_ = 0;  ///< came back between from_ns and until_ns
  std::atomic<bool> overrun_ = false;
  LatencyHistogram latency_;
};

}  // namespace iotcloud::bench::paper
