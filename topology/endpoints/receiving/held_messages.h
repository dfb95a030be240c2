#pragma once

#include <atomic>
#include <cstddef>
#include <map>
#include <string>

#include <iotcloud/config/mutex.h>

namespace iotcloud::topology {

/// Counts the messages that the spouts of a worker have taken from brokers and not settled: how many bytes, within
/// which limit their prefetch may grow, and whose prefetch is the limit now. Thread safe.
class HeldMessages {
 public:
  /// The default limit on the bytes that all spouts of a worker hold together. A prefetch that would need more is not
  /// raised.
  static constexpr std::size_t usual_limit = std::size_t{256} << 20U;
  explicit HeldMessages(std::size_t most_bytes = usual_limit) : most_bytes_(most_bytes) {}

  void add(std::size_t bytes) { bytes_.fetch_add(bytes, std::memory_order_relaxed); }
  void remove(std::size_t bytes) { bytes_.fetch_sub(bytes, std::memory_order_relaxed); }
  /// Whether so many bytes more are within the limit.
  bool has_room(std::size_t more) const { return bytes_.load(std::memory_order_relaxed) + more <= most_bytes_; }

  /// Says why a spout gets no more messages; empty: it gets what there is.
  void set_limit(const std::string& component, const std::string& text);
  /// The limit as set_limit() put it, for people: "in: prefetchCount ..."; empty: there is no limit.
  std::string limits() const;

 private:
  const std::size_t most_bytes_;
  std::atomic<std::size_t> bytes_{0};
  mutable config::Mutex mutex_;
  std::map<std::string, std::string> limits_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by component
};

}  // namespace iotcloud::topology
