#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace iotcloud::bench {

struct SoakOptions {
  double rate = 0;  ///< tuples a second while active; 0: as many as possible
  std::chrono::milliseconds length{3000};
  std::chrono::milliseconds longest_calm{400};  ///< the next disturbance comes after this at most; 0: none come
  std::uint64_t seed = 1;
  std::chrono::milliseconds longest_drain{60000};  ///< given to what is under way at the end
};

/// What was counted, by the components themselves. Valid at any time; the sums agree once a run has ended.
struct SoakCounts {
  std::uint64_t emitted = 0, acked = 0, failed = 0;  ///< as the spouts heard
  std::uint64_t refused = 0;                         ///< failed by a bolt on purpose
  std::uint64_t arrived = 0;                         ///< executed by the last bolt
  std::uint64_t out_of_order = 0;  ///< arrived behind a later tuple of its key, or at another task than the key's
  std::uint64_t overlapping = 0;   ///< calls of one task that ran while another one did
  std::uint64_t unknown_ends = 0;  ///< acks and fails of a tuple that was not under way
  std::uint64_t rebalances = 0, pauses = 0;
};

/// A topology of spouts (2 tasks), a bolt that passes on, fails one tuple of 1000 and now and then takes long, and a
/// bolt that checks the order of each key; both bolts have 8 tasks and are grouped by key; everything is tracked.
/// While it runs it is disturbed at random: paused, gone on with, rebalanced to 1 ... 8.
class Soak {
 public:
  explicit Soak(const SoakOptions& options);
  ~Soak();
  /// Runs it on this thread, once, to the end: until nothing is under way, or longest_drain has passed.
  /// \param progress called about once a second; may be empty.
  void run(const std::function<void(const SoakCounts&, std::chrono::milliseconds left)>& progress = {});
  SoakCounts counts() const;
  /// What is wrong after run(), one line each; empty: every tuple is accounted for, no key was out of order.
  std::vector<std::string> violations() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::bench
