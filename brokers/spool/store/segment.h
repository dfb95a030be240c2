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

  /// Makes a new file. \return null with errno set when it cannot.
  static std::shared_ptr<Segment> create(const std::string& folder, std::uint64_t first, Disk& disk);
  /// Opens one that is there. \throws config::Error when it cannot, or when it is of a later version.
  static std::shared_ptr<Segment> open(const std::string& folder, std::uint64_t first, Disk& disk);
  /// The sequence number of the first record of the file of this name; nullopt when it is no segment's.
  static std::optional<std::uint64_t> first_of(std::string_view file_name);
  ~Segment();
  Segment(const Segment&) = delete;
  Segment& operator=(const Segment&) = delete;

  std::uint64_t first() const { return first_; }
  const std::string& path() const { return path_; }
  /// Bytes in the file that are whole: readers go no further.
  std::uint64_t size() const { return size_.load(std::memory_order_acquire); }
  int descriptor() const { return descriptor_; }

  /// Appends a record's head and payload. \return 0, or an errno with the file as it was before.
  int append(std::string& head, const Payload& payload);
  /// Takes the last bytes off: they are no whole record. \return 0 or an errno
  int cut(std::uint64_t size);
  int sync() { return disk_.sync(descriptor_); }
  /// Removes the file, or keeps it aside under another name when a reader found damage in it. \return its new path
  std::string remove();

  /// A reader found bytes that are no records.
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

/// Reads one segment's records in order, and goes on behind what is damaged. Not thread safe.
class SegmentReader {
 public:
  SegmentReader(std::shared_ptr<Segment> segment, std::uint64_t offset);

  /// The next good record; nullopt at the end (ask again after an append).
  std::optional<Record> next();
  /// Behind the last good record.
  std::uint64_t offset() const { return good_end_; }
  /// Bytes so far that were no records and had good ones behind them.
  std::uint64_t skipped() const { return skipped_; }
  /// Bytes at the end that are no record.
  std::uint64_t bad_tail() const { return std::max(segment_->size(), good_end_) - good_end_; }
  /// Whether they are the beginning of one. Ask when next() has found no more.
  bool tail_is_torn();
  const std::shared_ptr<Segment>& segment() const { return segment_; }

 private:
  bool fill(std::size_t wanted);
  std::span<const std::byte> view() const { return std::span(buffer_).subspan(begin_); }

  const std::shared_ptr<Segment> segment_;
  std::uint64_t offset_;  ///< in the file, of what is looked at
  std::uint64_t good_end_;
  std::uint64_t skipped_ = 0;
  std::vector<std::byte> buffer_;
  std::size_t begin_ = 0;  ///< in the buffer, of what is looked at
};

}  // namespace iotcloud::brokers::spool
