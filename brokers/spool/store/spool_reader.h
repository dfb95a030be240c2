#pragma once

#include <cstdint>
#include <optional>

#include "iotcloud/brokers/spool/store/spool_store.h"

namespace iotcloud::brokers::spool {

/// Reads a store's records in order, a piece of a file at a time, while other threads append and drop. It skips damaged
/// records; the next record's number tells how many are missing. Not thread safe.
class SpoolReader {
 public:
  explicit SpoolReader(const SpoolStore& store) : store_(store) {}

  /// Goes to a record; if its segment was dropped, to the start of the next one.
  void seek(const Position& position);
  /// The next record; nullopt if there is none yet.
  std::optional<Record> next();
  /// Number of damaged bytes that were skipped since the last call.
  std::uint64_t take_damaged_bytes();

 private:
  void open(std::shared_ptr<Segment> segment, std::uint64_t offset);
  void close();

  const SpoolStore& store_;
  std::optional<SegmentReader> current_;
  std::uint64_t damaged_ = 0;  ///< number of damaged bytes in files before the current one
  std::uint64_t taken_ = 0;    ///< what take_damaged_bytes() has returned so far, added up
};

}  // namespace iotcloud::brokers::spool
