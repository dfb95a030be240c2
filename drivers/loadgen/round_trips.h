#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace iotcloud::drivers::loadgen {

/// Counts durations in buckets of 1/32 octave: a quantile is within 1.6 % of the true one, the largest is exact.
/// Not thread safe.
class Latencies {
 public:
  void add(std::chrono::nanoseconds duration);
  std::uint64_t count() const { return count_; }
  /// In microseconds; 0 if there are no durations. \param share 0 to 1; 1 is the largest.
  double quantile_us(double share) const;
  double mean_us() const { return count_ == 0 ? 0 : sum_us_ / static_cast<double>(count_); }

 private:
  static constexpr std::size_t steps = 32;  ///< buckets for each octave
  static std::size_t bucket(std::uint64_t ns);
  static double middle_ns(std::size_t bucket);
  std::vector<std::uint64_t> buckets_;  ///< up to the largest used: there may be thousands of generators
  std::uint64_t count_ = 0, largest_ns_ = 0;
  double sum_us_ = 0;
};

/// Tracks a sequence of messages that are sent and come back, with one bit of memory for each. Not thread safe.
class RoundTrips {
 public:
  /// \param warm_up the latencies of so many messages from the first on are kept apart
  explicit RoundTrips(std::uint64_t warm_up = 0) : warm_up_(warm_up) {}
  void sent() { ++sent_; }
  /// Notes that a message came back. Only the first time counts for the latencies.
  /// \param latency since the message was due. \return false for a number that was never sent.
  bool received(std::uint64_t sequence, std::chrono::nanoseconds latency);

  std::uint64_t sent_count() const { return sent_; }
  std::uint64_t received_count() const { return received_; }  ///< each message once
  std::uint64_t lost() const { return sent_ - received_; }    ///< includes messages that may still come
  std::uint64_t duplicated() const { return duplicated_; }
  std::uint64_t out_of_order() const { return out_of_order_; }  ///< came after a message that was sent later
  /// The largest distance between a message's number and the largest number that came before it; duplicates count too.
  std::uint64_t furthest_back() const { return furthest_back_; }
  const Latencies& latencies() const { return latencies_; }
  const Latencies& latencies_of_warm_up() const { return latencies_of_warm_up_; }

 private:
  std::uint64_t warm_up_;
  std::uint64_t sent_ = 0, received_ = 0, duplicated_ = 0, out_of_order_ = 0;
  std::uint64_t furthest_back_ = 0;
  std::uint64_t newest_ = 0;  ///< the largest number that came back, plus one
  std::vector<bool> seen_;
  Latencies latencies_, latencies_of_warm_up_;
};

}  // namespace iotcloud::drivers::loadgen
