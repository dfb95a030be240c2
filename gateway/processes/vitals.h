#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>

namespace iotcloud::gateway {

/// What a process may take; 0: as much as it wants.
struct VitalLimits {
  std::uint64_t memory_bytes = 0;
  /// A thread that has not slept for this long spins: it gets nothing done that it would ever wait for.
  std::chrono::milliseconds spin{60'000};
};

/// What one process takes of the machine, as Linux tells it in /proc: its memory, and whether a thread of it never
/// sleeps. Whether others use the machine makes no difference: a thread that waits for a processor does not sleep.
/// Used on one thread.
class Vitals {
 public:
  using Instant = std::chrono::steady_clock::time_point;

  /// \param folder /proc/<process>, or one with the same files.
  Vitals(std::string folder, VitalLimits limits);

  /// Looks once; call it regularly, with times that grow. \return which limit is passed, for people; empty: none is, or
  /// the process is gone.
  std::string examine(Instant now);
  /// As examine() saw it last.
  std::uint64_t memory_bytes() const { return memory_bytes_; }

 private:
  struct Thread {
    Instant since;                     ///< it has not slept from here on,
    std::chrono::nanoseconds busy{0};  ///< when it had been running, or waiting to run, for so long
    bool seen = false;                 ///< in this examination
  };
  std::string spinning_thread(Instant now);

  const std::string folder_;
  const VitalLimits limits_;
  std::uint64_t memory_bytes_ = 0;
  std::map<std::string, Thread> threads_;  ///< by id
};

}  // namespace iotcloud::gateway
