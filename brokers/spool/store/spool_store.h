#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "iotcloud/brokers/spool/store/mark_file.h"
#include "iotcloud/brokers/spool/store/segment.h"

namespace iotcloud::brokers::spool {

/// When what was appended is put on the disk. All survive the death of the process at any point.
enum class Sync {
  never,     ///< when the system does so: a loss of power costs the last half minute
  interval,  ///< now and then, see SpoolOptions
  always,    ///< before append() returns
};

/// Where a record begins.
struct Position {
  std::uint64_t segment = 0;  ///< first sequence number in it
  std::uint64_t offset = 0;   ///< in bytes
};

/// The folder of one spool: a log of records in segments, and the mark below which all are done with. FORMAT.md says
/// what is in the files. One thread appends (append, start_segment, drop_oldest) while others read, release and sync.
class SpoolStore {
 public:
  struct Options {
    std::string folder;                                  ///< made when it is missing
    std::uint64_t max_bytes = std::uint64_t{256} << 20;  ///< of all segments together
    Sync sync = Sync::interval;
    /// A process that was killed may hold the folder a moment longer.
    std::chrono::milliseconds lock_limit{500};
    Disk* disk = nullptr;  ///< nullptr: the real one
  };
  /// What was found when the folder was opened.
  struct Found {
    std::uint64_t messages = 0;       ///< that are not done with; less what turns out to be damaged
    std::uint64_t torn_bytes = 0;     ///< taken off the end: what was being written when the process or machine stopped
    std::uint64_t damaged_bytes = 0;  ///< taken off the end and kept aside: they are no beginning of a record
    std::uint64_t missing_messages = 0;  ///< at the beginning: their files are gone
    bool mark_lost = false;              ///< what was done with is not known: all that is there is sent again
  };
  enum class Append {
    stored,
    full,       ///< `max_bytes` would be passed: drop_oldest(), or wait for release()
    too_large,  ///< will never fit
    failed,     ///< the disk is full or broken: see problem()
  };

  /// Locks and repairs the folder. \throws config::Error when it cannot be used, or another process (or object) uses
  /// it.
  explicit SpoolStore(Options options);
  /// Removes the files, and the folder, when everything is done with and nothing is kept aside.
  ~SpoolStore();
  SpoolStore(const SpoolStore&) = delete;
  SpoolStore& operator=(const SpoolStore&) = delete;

  const Found& found() const { return found_; }
  const std::string& folder() const { return options_.folder; }
  /// The sequence number that the next record gets.
  std::uint64_t next_sequence() const { return next_; }
  std::uint64_t mark() const;
  std::uint64_t bytes() const { return bytes_.load(std::memory_order_relaxed); }

  Append append(std::int64_t accepted_ms, const Message& message, Position& where);
  /// Bytes that the message of the last append() takes, or would take.
  std::uint64_t last_size() const { return size_; }
  /// What the last append that failed met, for people.
  const std::string& problem() const { return problem_; }
  /// Gives up the oldest segment. \return the first sequence number that is kept.
  std::uint64_t drop_oldest();

  /// Everything below is done with. Cheap; lasts when the process is killed.
  void raise_mark(std::uint64_t mark);
  /// Whether append() would find room for a message of this size.
  bool has_room(std::uint64_t size) const;
  /// Whether release() has something to do.
  bool releasable() const;
  /// Removes segments that are done with.
  void release();
  /// Puts on the disk what was appended and is not done with. \return 0 or an errno
  int sync();

  /// The segment that holds a sequence number, or else the next there is; null when there is none.
  std::shared_ptr<Segment> segment_at(std::uint64_t sequence) const;
  std::shared_ptr<Segment> segment_after(std::uint64_t first) const;

 private:
  void lock_folder();
  void find_segments();
  void repair_last();
  bool start_segment();
  bool make_room(std::uint64_t size);
  void remove(const std::shared_ptr<Segment>& segment);
  std::shared_ptr<Segment> last() const;

  const Options options_;
  Disk& disk_;
  const std::uint64_t segment_bytes_;
  int lock_ = -1;
  int folder_descriptor_ = -1;
  Found found_;

  // The appending thread's.
  std::string head_;
  std::uint64_t size_ = 0;
  std::string problem_;
  std::uint64_t own_from_ = 1;  ///< files with lower numbers are an earlier process's
  std::atomic<std::uint64_t> next_{1};

  std::atomic<std::uint64_t> bytes_{0};
  mutable std::mutex mutex_;
  std::deque<std::shared_ptr<Segment>> segments_;   ///< by first; the last may take more; guarded by mutex_
  std::vector<std::shared_ptr<Segment>> unsynced_;  ///< complete, and for sync() to put on the disk; guarded by mutex_
  std::optional<MarkFile> mark_;                    ///< guarded by mutex_
  bool mark_failed_ = false;                        ///< said in the log; guarded by mutex_
};

}  // namespace iotcloud::brokers::spool
