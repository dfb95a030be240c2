#pragma once

#include <array>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {

/// Why a message was dropped, in the words of on_outcome and the metrics.
namespace reason {
/// a newer one replaced it while it waited (keep_newest, keep_last)
inline constexpr const char* superseded = "superseded";
inline constexpr const char* deadline = "deadline";        ///< it grew too old
inline constexpr const char* no_reader = "no_reader";      ///< superseded while the topic had no reader
inline constexpr const char* undecodable = "undecodable";  ///< received bytes that are not a message
inline constexpr const char* fenced = "fenced";            ///< its sender lost the right to send it (void_before)
inline constexpr const char* closed = "closed";            ///< the publisher was closed first
// Of a spool (spool/spooled_publisher.h):
inline constexpr const char* spool_full = "spool_full";        ///< the oldest gave way (drop_oldest)
inline constexpr const char* spool_failed = "spool_failed";    ///< the disk is full or broken (drop_oldest)
inline constexpr const char* spool_damaged = "spool_damaged";  ///< it became unreadable
/// closed first: the spool keeps it, and the next publisher sends it
inline constexpr const char* spooled = "spooled";
}  // namespace reason

/// Counters of one kind of broker, shared by all its broker objects in the process. Thread safe.
class Meters {
 public:
  /// \param metrics nullptr: the process's own. \param kind "embedded", "rabbitmq"
  Meters(config::Metrics* metrics, const std::string& kind);
  void outcome(Outcome outcome, const std::string& reason);
  void received(bool redelivered);
  void conflated();  ///< a delivery that keep_last skipped
  /// The server confirmed a message before an earlier one of its topic: readers may have got them in that order.
  void overtook();
  /// No handler got a record: it was undecodable, or expired on a server without deadlines.
  void skipped(const std::string& reason);

 private:
  config::Metrics& metrics_;
  std::string kind_;
  config::Counter& confirmed_;
  config::Counter& received_;
  config::Counter& redelivered_;
  config::Counter& conflated_;
};

}  // namespace iotcloud::brokers
