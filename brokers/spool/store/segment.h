#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "iotcloud/brokers/spool/store/disk.h"
#include "iotcloud/brokers/spool/store/record.h"

namespace iotcloud::brokers::spool {

/// One file of a spool: a start of 16 bytes, then records. One thread appends while others read.
class Segment {
 public:
  static constexpr std::size_t file_start = 16;

  /// Makes a new file. \return null with errno set if it cannot.
  static std::shared_ptr<Segment> create(const std::string& folder, std::uint64_t first, Disk& disk);
  /// Opens an existing file. \throws config::Error if it cannot, or if the file is of a later version.
  static std::shared_ptr<Segment> open(const std::string& folder, std::uint64_t first, Disk& disk);
  /// The first sequence number of the file with this name; nullopt if it is not a segment.
  static std::optional<std::uint64_t> first_of(std::string_view file_name);
  ~Segment();
  Segment(const Segment&) = delete;
  Segment& operator=(const Segment&) = delete;

  std::uint64_t first() const { return first_; }
  const std::string& path() const { return path_; }
  /// Size of the complete records: readers read no further.
  std::uint64_t size() const { return size_.load(std::memory_order_acquire); }
  int descriptor() const { return descriptor_; }

  /// Appends a record's head and payload. \return 0, or an errno, after which the file is unchanged.
  int append(std::string& head, const Payload& payload);
  /// Cuts the file to `size` bytes, to remove an end that is no complete record. \return 0 or an errno.
  int cut(std::uint64_t size);
  int sync() { return disk_.sync(descriptor_); }
  /// Removes the file, or renames it if a reader found damage in it. \return its new path; empty: it was removed.
  std::string remove();

  /// Notes that a reader found bytes that are not records, so that remove() keeps the file.
  void note_damage() { damaged_ = true; }

 private:
  Segment(std::string path, std::uint64_t first, int descriptor, Disk& disk);

  const std::string path_;
  const std::uint64_t first_;
  const int descriptor_;
  Disk& disk_;
  std::atomic<std::uint64_t> size_{0};
  std::atomic<bool> damaged_{false};
};

/// Reads one segment's records in order, and continues after damaged ones. Not thread safe.
class SegmentReader {
 public:
  SegmentReader(std::shared_ptr<Segment> segment, std::uint64_t offset);

  /// The next good record; nullopt at the end (call again after an append).
  std::optional<Record> next();
  /// End of the last good record.
  std::uint64_t offset() const { return good_end_; }
  /// Number of damaged bytes so far that have a good record behind them.
  std::uint64_t skipped() const { return skipped_; }
  /// Number of bytes at the end that are not a record.
  std::uint64_t bad_tail() const { return std::max(segment_->size(), good_end_) - good_end_; }
  /// Whether the bytes at the end are the beginning of a record. \pre next() found no more records.
  bool tail_is_torn();
  const std::shared_ptr<Segment>& segment() const { return segment_; }

 private:
  bool fill(std::size_t wanted);
  std::span<const std::byte> view() const { return std::span(buffer_).subspan(begin_); }

  const std::shared_ptr<Segment> segment_;
  std::uint64_t offset_;  ///< offset in the file of the current position
  std::uint64_t good_end_;
  std::uint64_t skipped_ = 0;
  std::vector<std::byte> buffer_;
  std::size_t begin_ = 0;  ///< offset in the buffer of the current position
};

}  // namespace iotcloud::brokers::spool
