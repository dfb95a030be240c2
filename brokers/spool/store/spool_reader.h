#pragma once

#include <cstdint>
#include <optional>

#include "iotcloud/brokers/spool/store/spool_store.h"

namespace iotcloud::brokers::spool {

/// Reads a store's records in order, a piece of a file at a time, while others append and drop. What is damaged is
/// passed over: the next record's number tells how many are missing. Not thread safe.
class SpoolReader {
 public:
  explicit SpoolReader(const SpoolStore& store) : store_(store) {}

  /// Goes to a record. When its segment is gone: to the next that is there.
  void seek(const Position& position);
  /// nullopt when there is no more.
  std::optional<Record> next();
  /// Bytes passed over since the last call.
  std::uint64_t take_damaged_bytes();

 private:
  void open(std::shared_ptr<Segment> segment, std::uint64_t offset);
  void close();

  const SpoolStore& store_;
  std::optional<SegmentReader> current_;
  std::uint64_t damaged_ = 0;  ///< in files before the current one
  std::uint64_t taken_ = 0;    ///< of all so far
};

}  // namespace iotcloud::brokers::spool
