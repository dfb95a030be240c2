#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "iotcloud/brokers/spool/store/mark_file.h"
#include "iotcloud/brokers/spool/store/segment.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::spool {

/// The place of a record.
struct Position {
  std::uint64_t segment = 0;  ///< first sequence number in it
  std::uint64_t offset = 0;   ///< in bytes
};

/// The folder of one spool: a log of records in segments, and the mark below which all records are finished. FORMAT.md
/// describes the files. One thread appends (append, drop_oldest) while others read, raise the mark, release and sync.
/// Appended records survive the death of the process at any point. Only sync() waits for the disk to have written.
class SpoolStore {
 public:
  struct Options {
    std::string folder;                                  ///< made if missing
    std::uint64_t max_bytes = std::uint64_t{256} << 20;  ///< of all segments together
    bool synced = true;                                  ///< false: the owner never calls sync()
    /// How long to wait for the folder's lock, which a killed process may hold for a moment after its death.
    std::chrono::milliseconds lock_limit{500};
    Disk* disk = nullptr;  ///< nullptr: the real one
  };
  /// The state of the folder when it was opened.
  struct Found {
    std::uint64_t messages = 0;          ///< unfinished ones, including some that may turn out to be damaged
    std::uint64_t torn_bytes = 0;        ///< bytes of an incomplete record that were cut off the end
    std::uint64_t damaged_bytes = 0;     ///< other bytes that were cut off the end; a copy of the file is kept
    std::uint64_t missing_messages = 0;  ///< unfinished messages before the first segment: their files are gone
    bool mark_lost = false;              ///< it is unknown which records were finished: all are sent again
  };
  enum class Append {
    stored,
    full,       ///< `max_bytes` would be exceeded: call drop_oldest(), or wait for release()
    too_large,  ///< the message alone exceeds `max_bytes`
    disk_full,  ///< drop_oldest() may make room; see problem()
    failed,     ///< the disk is broken, and dropping does not help; see problem()
  };

  /// Locks and repairs the folder. \throws config::Error if it cannot be used, or another process (or object) uses it.
  explicit SpoolStore(Options options);
  /// Removes the files if all records are finished, and the folder if no damaged file is kept in it.
  ~SpoolStore();
  SpoolStore(const SpoolStore&) = delete;
  SpoolStore& operator=(const SpoolStore&) = delete;

  const Found& found() const { return found_; }
  const std::string& folder() const { return options_.folder; }
  /// The sequence number that the next record gets.
  std::uint64_t next_sequence() const { return next_; }
  std::uint64_t mark() const { return mark_.load(std::memory_order_acquire); }
  std::uint64_t bytes() const { return bytes_.load(std::memory_order_relaxed); }

  Append append(std::int64_t accepted_ms, const Message& message, Position& where);
  /// The size of the last append()'s message on disk, even if append() failed.
  std::uint64_t last_size() const {
    appender_.assert_held();
    return size_;
  }
  /// Why the last append() failed, as a text for the log.
  const std::string& problem() const {
    appender_.assert_held();
    return problem_;
  }
  /// Drops the oldest segment. \return the first sequence number that remains.
  std::uint64_t drop_oldest();

  /// Marks all records below `mark` as finished. One small write, without a sync; survives the death of the process.
  void raise_mark(std::uint64_t mark);
  /// Whether append() would find room for a message of this size.
  bool has_room(std::uint64_t size) const;
  /// Whether release() has something to remove.
  bool releasable() const;
  /// Removes finished segments.
  void release();
  /// Syncs unfinished records to the disk that were appended before the call; one call at a time. \return 0, or an
  /// errno: then some of them may never reach the disk, even if a later call succeeds.
  int sync();

  /// The segment of a sequence number, or else the next one; null if there is none.
  std::shared_ptr<Segment> segment_at(std::uint64_t sequence) const;
  std::shared_ptr<Segment> segment_after(std::uint64_t first) const;

 private:
  void lock_folder();
  /// Brings the names of new folders to the disk. \return 0 or an errno
  int sync_new_names();
  void find_segments() IOTCLOUD_REQUIRES(mutex_);
  void repair_last() IOTCLOUD_REQUIRES(mutex_);
  /// \return 0 or an errno
  int start_segment() IOTCLOUD_REQUIRES(appender_);
  bool make_room(std::uint64_t size);
  void remove(const std::shared_ptr<Segment>& segment);
  std::shared_ptr<Segment> last() const;

  const Options options_;
  Disk& disk_;
  const std::uint64_t segment_bytes_;
  int lock_ = -1;
  int folder_descriptor_ = -1;
  std::set<std::string> new_names_in_;  ///< folders in which a folder was made since they were synced; used by sync()
  Found found_;

  config::ThreadRole appender_;
  std::string head_ IOTCLOUD_GUARDED_BY(appender_);
  std::uint64_t size_ IOTCLOUD_GUARDED_BY(appender_) = 0;
  std::string problem_ IOTCLOUD_GUARDED_BY(appender_);
  std::uint64_t own_from_ = 1;  ///< records below this are in files of an earlier process; the constructor sets it
  std::atomic<std::uint64_t> next_{1};

  std::atomic<std::uint64_t> bytes_{0};
  mutable config::Mutex mutex_;
  /// In order of their first record; only the last one may grow.
  std::deque<std::shared_ptr<Segment>> segments_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Segments that are complete, but not synced yet.
  std::vector<std::shared_ptr<Segment>> unsynced_ IOTCLOUD_GUARDED_BY(mutex_);
  bool folder_unsynced_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< a file was made since the folder was synced

  std::atomic<std::uint64_t> mark_{0};  ///< the mark in mark_file_, to be read without mark_mutex_
  /// Held while the mark is written, which may be slow; append() takes it only where it drops a segment.
  config::Mutex mark_mutex_;
  std::optional<MarkFile> mark_file_ IOTCLOUD_GUARDED_BY(mark_mutex_);
  bool mark_failed_ IOTCLOUD_GUARDED_BY(mark_mutex_) = false;  ///< the failure was logged
};

}  // namespace iotcloud::brokers::spool
