#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <string>

#include <iotcloud/config/mutex.h>

namespace iotcloud::gateway {

/// Counts what became of the messages of one channel of one instance since it was opened. The metrics count the same
/// for all instances of a driver together. Thread safe.
class ChannelTally {
 public:
  /// A broker has confirmed a message, or the driver has handled it.
  void done() { done_.fetch_add(1, std::memory_order_relaxed); }
  /// Messages had another end. \param fate such as "dropped: superseded"; after the first most_fates others are
  /// counted as "others"
  void lost(const std::string& fate, std::int64_t messages = 1);
  /// A message was not taken: its driver was told so, and may try again.
  void refused(const std::string& fate);

  struct Counts {
    std::int64_t done = 0;
    std::map<std::string, std::int64_t> lost;
  };
  Counts counts() const;
  /// The messages that lost() has counted so far, and what became of the last of them.
  struct Losses {
    std::int64_t messages = 0;
    std::string fate;
  };
  Losses losses() const;
  static constexpr std::size_t most_fates = 32;

 private:
  void add(const std::string& fate, std::int64_t messages) IOTCLOUD_REQUIRES(mutex_);

  std::atomic<std::int64_t> done_{0};
  mutable config::Mutex mutex_;
  Losses losses_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::string, std::int64_t> lost_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
