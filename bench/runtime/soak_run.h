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
  std::chrono::milliseconds longest_calm{400};  ///< longest time to the next disturbance; 0: no disturbances
  std::uint64_t seed = 1;
  std::chrono::milliseconds longest_drain{60000};  ///< longest time for tuples under way at the end
};

/// Counts made by the components themselves. Valid at any time; the sums agree once a run has ended.
struct SoakCounts {
  std::uint64_t emitted = 0, acked = 0, failed = 0;  ///< as the spouts saw them
  std::uint64_t refused = 0;                         ///< failed by a bolt on purpose
  std::uint64_t arrived = 0;                         ///< executed by the last bolt
  std::uint64_t out_of_order = 0;  ///< arrived after a later tuple of its key, or at another task than its key's
  std::uint64_t overlapping = 0;   ///< calls of one task that ran while another one did
  std::uint64_t unknown_ends = 0;  ///< acks and fails of tuples that were not under way
  std::uint64_t rebalances = 0, pauses = 0;
};

/// A topology of spouts (2 tasks), a bolt that passes tuples on, fails one of 1000 and sometimes takes long, and a bolt
/// that checks the order of each key. Both bolts have 8 tasks and are grouped by key; all tuples are tracked. While it
/// runs it is disturbed at random: paused, resumed, rebalanced to 1 ... 8.
class Soak {
 public:
  explicit Soak(const SoakOptions& options);
  ~Soak();
  /// Runs once, on this thread, until no tuple is under way or longest_drain has passed.
  /// \param progress called about once a second; may be empty.
  void run(const std::function<void(const SoakCounts&, std::chrono::milliseconds left)>& progress = {});
  SoakCounts counts() const;
  /// The faults after run(), one line for each; empty if every tuple is accounted for and no key was out of
  /// order.
  std::vector<std::string> violations() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::bench
