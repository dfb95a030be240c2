#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers::spool {

/// Metrics of one spool. The gauges of spools with the same labels add up. Thread safe.
class SpoolMeters {
 public:
  /// \param metrics nullptr: the process's.
  SpoolMeters(config::Metrics* metrics, const config::Labels& labels);
  ~SpoolMeters();  ///< calls close() unless the owner did
  SpoolMeters(const SpoolMeters&) = delete;
  SpoolMeters& operator=(const SpoolMeters&) = delete;

  /// Sets this spool's part of the gauges. The caller must not call it on two threads at a time.
  void level(std::uint64_t messages, std::uint64_t bytes);
  /// Subtracts this spool's part from the gauges. Afterwards nothing of the metrics is touched any more, the destructor
  /// included: the metrics may be destroyed before this object.
  void close() { level(0, 0); }
  void dropped(const std::string& reason, std::uint64_t count);
  void restored(std::uint64_t count) { restored_.add(count); }
  void damaged_bytes(std::uint64_t count) { damaged_bytes_.add(count); }
  void torn_bytes(std::uint64_t count) { torn_bytes_.add(count); }
  void disk_failed() { disk_failures_.add(); }

 private:
  config::Metrics& metrics_;
  const config::Labels labels_;
  config::Gauge& messages_;
  config::Gauge& bytes_;
  config::Counter& restored_;
  config::Counter& damaged_bytes_;
  config::Counter& torn_bytes_;
  config::Counter& disk_failures_;
  std::uint64_t own_messages_ = 0;
  std::uint64_t own_bytes_ = 0;
};

}  // namespace iotcloud::brokers::spool
