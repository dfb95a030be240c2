#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>

namespace iotcloud::topology {

/// What waits at brokers for some readers, as the brokers said last (brokers::Subscription::backlog()).
struct Backlog {
  std::size_t known = 0;       ///< how many readers' brokers said it; 0: nothing is known
  std::uint64_t messages = 0;  ///< of these readers together
  std::string topic;           ///< that has the most; empty: none has any
  std::uint64_t most = 0;      ///< its messages

  /// Adds a reader's.
  void add(const std::string& of_topic, std::uint64_t count) {
    ++known;
    messages += count;
    if (count <= most) return;
    most = count;
    topic = of_topic;
  }
};

/// The units of placement that the tasks of one spout read in this worker, in the order of their names.
struct ReadUnits {
  struct Unit {
    std::string name;  ///< a driver instance, or a driver on a gateway, perhaps with a partition
    int task = 0;      ///< index of the task that reads it
    friend bool operator==(const Unit&, const Unit&) = default;
  };
  std::vector<Unit> units;  ///< most_units at most
  std::size_t more = 0;     ///< units that are not listed
  static constexpr std::size_t most_units = 2'000;
  friend bool operator==(const ReadUnits&, const ReadUnits&) = default;
};

/// What is on its way to one spout component: how old messages are when they come, and how many wait at brokers. Thread
/// safe.
class Arrivals {
 public:
  struct Facts {
    /// The age of the oldest message in the last second in which any message came; nullopt: none came.
    std::optional<std::int64_t> age_ms;
    Backlog backlog;
  };

  /// Notes that a message came. \param age_ms its age by its own time stamp. Wait free.
  void came(std::int64_t age_ms) {
    std::int64_t oldest = oldest_ms_.load(std::memory_order_relaxed);
    while (age_ms > oldest && !oldest_ms_.compare_exchange_weak(oldest, age_ms, std::memory_order_relaxed)) {
    }
  }
  /// To be called once a second. \param backlog as it is now
  void look(Backlog backlog);
  Facts facts() const;
  void set_units(ReadUnits units);
  ReadUnits units() const;

 private:
  static constexpr std::int64_t none = -1;
  std::atomic<std::int64_t> oldest_ms_{none};  ///< of the messages that came since the last look
  mutable config::Mutex mutex_;
  Facts facts_ IOTCLOUD_GUARDED_BY(mutex_);
  ReadUnits units_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
