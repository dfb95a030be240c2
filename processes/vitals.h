#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>

namespace iotcloud::processes {

/// Limits of a process; 0: no limit.
struct VitalLimits {
  std::uint64_t memory_bytes = 0;
  /// A thread spins if it has not slept for this long and has run for at least half of that time.
  std::chrono::milliseconds spin{60'000};
};

/// Watches one process in /proc: its memory, and whether one of its threads never sleeps. Time in which a thread waits
/// for a processor does not count as sleep, so a spinning thread is found on a busy machine too, although later if it
/// gets less than half of a processor. A thread that mostly waits for a processor does not count as spinning. Used on
/// one thread.
class Vitals {
 public:
  using Instant = std::chrono::steady_clock::time_point;

  /// \param folder `/proc/<process>`, or one with the same files.
  Vitals(std::string folder, VitalLimits limits);

  /// Checks the process once. Call it regularly, with ascending times. \return which limit is exceeded, for people;
  /// empty: none, or the process has ended.
  std::string examine(Instant now);
  /// The memory at the last examine().
  std::uint64_t memory_bytes() const { return memory_bytes_; }

 private:
  struct Thread {
    Instant since;                     ///< the thread has not slept since this time
    std::chrono::nanoseconds busy{0};  ///< at `since`: how long it had run or waited for a processor
    std::chrono::nanoseconds ran{0};   ///< at `since`: how long it had run
    bool seen = false;                 ///< listed in the current examination
  };
  std::string spinning_thread(Instant now);

  const std::string folder_;
  const VitalLimits limits_;
  std::uint64_t memory_bytes_ = 0;
  std::map<std::string, Thread> threads_;  ///< by thread id
};

}  // namespace iotcloud::processes
