#pragma once

#include <array>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {

/// Why a message was dropped: the words that on_outcome and the metrics use.
namespace reason {
inline constexpr const char* superseded = "superseded";  ///< a newer one came while it waited (keep_newest, keep_last)
inline constexpr const char* deadline = "deadline";      ///< it grew too old
inline constexpr const char* no_reader = "no_reader";    ///< superseded while nobody read the topic
inline constexpr const char* undecodable = "undecodable";  ///< received bytes that make no message
inline constexpr const char* fenced = "fenced";            ///< its sender lost the right to send it (void_before)
inline constexpr const char* closed = "closed";            ///< the publisher was closed first
// Of a spool (spool/spooled_publisher.h):
inline constexpr const char* spool_full = "spool_full";        ///< the oldest gave way (drop_oldest)
inline constexpr const char* spool_failed = "spool_failed";    ///< the disk is full or broken (drop_oldest)
inline constexpr const char* spool_damaged = "spool_damaged";  ///< it could not be read any more
inline constexpr const char* spooled = "spooled";              ///< closed first: it is kept, and sent by the next one
}  // namespace reason

/// What a broker of one kind counts. The counters are the process's, not one broker object's. Thread safe.
class Meters {
 public:
  /// \param metrics nullptr: the process's own. \param kind "embedded", "rabbitmq"
  Meters(config::Metrics* metrics, const std::string& kind);
  void outcome(Outcome outcome, const std::string& reason);
  void received(bool redelivered);
  void conflated();  ///< a delivery that keep_last skipped
  /// A message that the server confirmed before an earlier one of its topic: readers may have got them in that order.
  void overtook();
  /// A record that no handler got: undecodable, or beyond its deadline where the server knows none.
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
