#pragma once

#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/worker/broker_watch.h>

namespace iotcloud::topology {

class Arrivals;

/// Writes the graph with its parallelism and each task's counts as JSON: {"topology", "worker", "active", "brokers":
/// [{"broker", "url", "state", "since_ms", "why"}], "arrivals": [{"component", "age_s", "backlog", "topic", "most"}],
/// "troubles": [{"component", "text"}], "components": [{"id", "kind", "parallelism", "tasks", "inputs", "streams"}],
/// "tasks": [{"component", "task", "emitted", ..., "execute": {"count", "p50_us", "p99_us", "max_us", "buckets":
/// [[upper end in us, count]]}, ...}]}. Of the arrivals `age_s` and `backlog` are null if they are not known; `topic`
/// has the most of the backlog.
std::string describe(const Runtime& runtime, const std::string& worker,
                     const std::vector<BrokerWatch::Link>& brokers = {},
                     const std::map<std::string, std::shared_ptr<const Arrivals>>& arrivals = {});

/// Of each payload, where nobody asks for more.
inline constexpr std::size_t usual_shown_bytes = 16;

/// Writes a tuple as JSON: {"time_ms", "task", "source", "stream", "fields"}. Payloads become {"bytes", "hex"} with
/// their first `shown_bytes`, "89 50 4e"; long strings are cut.
std::string describe(const Tuple& tuple, int task, std::int64_t wall_ms, std::size_t shown_bytes = usual_shown_bytes);

/// Taps for clients that poll. The first poll() with an id opens a tap; end() ends it, and so does a pause in polling
/// of `patience`. The number of samples that wait is bounded. Thread safe.
class TapDesk {
 public:
  struct Options {
    const config::Clock* clock = nullptr;  ///< must outlive the desk; nullptr: the system's
    std::chrono::milliseconds patience{5000};
    std::size_t most_taps = 16;
    std::size_t most_samples = 1000;  ///< how many samples wait in one tap at most; the oldest are dropped
    std::size_t most_sample_bytes = std::size_t{4} << 20U;  ///< and how long they are together, but for the latest one
  };
  /// \param runtime must outlive the desk.
  TapDesk(Runtime& runtime, Options options);
  /// Ends all taps.
  ~TapDesk();
  TapDesk(const TapDesk&) = delete;
  TapDesk& operator=(const TapDesk&) = delete;

  /// \param stream shows only tuples of this stream; empty: all. \param per_second the most samples of each task in a
  /// second. \param shown_bytes as in describe(). Only the first poll of a tap decides these. \return {"samples":
  /// [...], "missed": n}: n samples were dropped since the last poll. \throws std::invalid_argument for an unknown
  /// component or too many taps; its text says what is possible.
  std::string poll(const std::string& id, const std::string& component, const std::string& stream, double per_second,
                   std::size_t shown_bytes = usual_shown_bytes);
  void end(const std::string& id);
  /// Ends taps that were not polled for `patience`. With the system's clock the desk calls it itself.
  void expire();
  std::size_t open() const;  ///< number of open taps

 private:
  struct Entry;
  using EntryPtr = std::shared_ptr<Entry>;
  EntryPtr find(const std::string& id, const std::string& component, const std::string& stream, double per_second,
                std::size_t shown_bytes);

  Runtime& runtime_;
  const Options options_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::map<std::string, EntryPtr> taps_ IOTCLOUD_GUARDED_BY(mutex_);
  std::jthread sweeper_;  ///< last, because it uses the other members; wakes up only while there are taps
};

}  // namespace iotcloud::topology
