#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/drivers/turtle/device.h>

namespace iotcloud::drivers::turtle {

/// One row of the trace (README.md has the columns).
struct FrameRecord {
  std::uint64_t sequence = 0;
  std::int64_t time_ms = 0;
  std::chrono::steady_clock::time_point captured;
  double device_time_s = 0;
  std::optional<GroundTruth> truth;
  double encode_us = 0;
  std::size_t payload_bytes = 0;
  PublishStatus published = PublishStatus::closed;
  std::optional<Velocity> answer;
  std::chrono::microseconds latency{0};  ///< of the answer
};

/// Remembers the frames that wait for their commands, matches commands to them, and writes the trace if there is one.
/// Not thread safe.
class FrameLog {
 public:
  using Instant = std::chrono::steady_clock::time_point;
  static constexpr std::chrono::seconds patience{5};  ///< a command later than this answers no frame

  struct Totals {
    std::uint64_t frames = 0, answered = 0, refused = 0, raw_bytes = 0, payload_bytes = 0;
    std::vector<std::uint32_t> latencies_us;  ///< the newest million
  };

  /// Opens the trace and writes its column names. \throws std::runtime_error that names the file.
  void open_trace(const std::string& path);
  /// Sets the time from which the trace counts capture times.
  void set_origin(Instant origin) { origin_ = origin; }

  void add(const FrameRecord& record);
  /// The newest frame was sent again: only its capture time and its publish status change.
  void repeat_newest(Instant captured, PublishStatus published);
  /// Notes that a command for the frame of this time came. \return the frame's record if this command is the first for
  /// it, otherwise nullptr (a second command, or an unknown or forgotten frame); valid until the next call.
  const FrameRecord* answer(std::int64_t time_ms, const Velocity& command, Instant arrived);
  bool newest_is(std::int64_t time_ms) const { return !waiting_.empty() && waiting_.back().time_ms == time_ms; }

  /// Writes the rows that are complete or too old, and flushes the file at most once a second.
  void tidy(Instant now);
  /// Writes all rows and closes the trace.
  void close();

  const Totals& totals() const { return totals_; }
  bool trace_failed() const { return trace_.is_open() && !trace_.good(); }

 private:
  void write(const FrameRecord& record);

  Instant origin_{};
  Instant flushed_{};
  std::deque<FrameRecord> waiting_;  ///< by time_ms; the front frame is not answered
  std::ofstream trace_;
  Totals totals_;
};

}  // namespace iotcloud::drivers::turtle
