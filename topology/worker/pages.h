#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// The graph with its parallelism, and what each task did, as JSON: {"topology", "worker", "active", "components":
/// [{"id", "kind", "parallelism", "tasks", "inputs", "streams"}], "tasks": [{"component", "task", "emitted", ...,
/// "execute": {"count", "p50_us", "p99_us", "max_us"}, ...}]}.
std::string describe(const Runtime& runtime, const std::string& worker);

/// A tuple as JSON: {"time_ms", "task", "source", "stream", "fields"}. Payloads are {"bytes", "hex"} with their first
/// 16 bytes; long strings are cut.
std::string describe(const Tuple& tuple, int task, std::int64_t wall_ms);

/// Taps that people who poll hold open: opened by the first poll() of an id, ended by end(), or when nobody has polled
/// for `patience`. What nobody has fetched is bounded. Thread safe.
class TapDesk {
 public:
  struct Options {
    const config::Clock* clock = nullptr;  ///< outlives the desk; nullptr: the system's
    std::chrono::milliseconds patience{5000};
    std::size_t most_taps = 16;
    std::size_t most_samples = 1000;  ///< that wait in one tap; older ones give way
  };
  /// \param runtime outlives the desk.
  TapDesk(Runtime& runtime, Options options);
  /// Ends all taps.
  ~TapDesk();
  TapDesk(const TapDesk&) = delete;
  TapDesk& operator=(const TapDesk&) = delete;

  /// \param stream only tuples of this one; empty: all. \param per_second for each task at most.
  /// \return {"samples": [...], "missed": n}, n of them having given way since the last poll.
  /// \throws std::invalid_argument saying what is possible: no such component, too many taps.
  std::string poll(const std::string& id, const std::string& component, const std::string& stream, double per_second);
  void end(const std::string& id);
  /// Ends those that nobody polls any more; called by itself with the system's clock.
  void expire();
  std::size_t open() const;

 private:
  struct Entry;
  using EntryPtr = std::shared_ptr<Entry>;
  EntryPtr find(const std::string& id, const std::string& component, const std::string& stream, double per_second);

  Runtime& runtime_;
  const Options options_;
  const config::Clock& clock_;
  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::map<std::string, EntryPtr> taps_;  ///< guarded by mutex_
  std::jthread sweeper_;                  ///< last: it uses the others; waits while there are taps only
};

}  // namespace iotcloud::topology
