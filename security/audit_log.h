#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>

namespace iotcloud::security {

/// Who did what, with which outcome.
struct AuditEntry {
  std::string who;          ///< the token's name; empty: no token was asked for or shown
  std::string role;         ///< "operator"
  std::string certificate;  ///< "CN=operator"; empty without TLS
  std::string address;      ///< "192.0.2.7:40112"
  std::string order;        ///< the method: "deploy"
  std::string what;         ///< "turtle.so on lab1"
  std::string outcome;      ///< "done", or the reason of the failure
  bool refused = false;     ///< the call was not authenticated or not allowed
};

/// A file of orders: a JSON object on each line with `time` (ISO 8601, UTC) and the members of AuditEntry. A line is on
/// disk before its order is answered, so write() waits for the disk, and the log survives a crash of the machine right
/// after the order. Lines that are added while the disk is busy are synced together. Thread safe.
class AuditLog {
 public:
  /// Syncs what was written to the disk; runs without a lock, and must not throw. \return false if that failed; errno
  /// says why
  using Sync = std::function<bool(int descriptor)>;
  /// Appends to the file; if it makes the file, only the owner may read it. \param sync empty: fdatasync.
  /// \throws Error if it cannot open the file.
  explicit AuditLog(std::string file, Sync sync = {});
  ~AuditLog();
  AuditLog(const AuditLog&) = delete;
  AuditLog& operator=(const AuditLog&) = delete;

  /// Writes a line, and returns when it is on the disk; logs an error if it cannot (a full disk).
  void write(const AuditEntry& entry) IOTCLOUD_EXCLUDES(mutex_);
  /// Opens the file by its name again, after somebody renamed the old file. When it has returned, nothing is written to
  /// the old file any more. \throws Error, and keeps the old one.
  void reopen() IOTCLOUD_EXCLUDES(mutex_);
  /// How many lines are not on the disk yet.
  std::size_t waiting() const IOTCLOUD_EXCLUDES(mutex_);

 private:
  void write_waiting() IOTCLOUD_REQUIRES(mutex_);
  void append(int descriptor, const std::vector<std::string>& lines) const noexcept IOTCLOUD_EXCLUDES(mutex_);

  const std::string file_;
  const Sync sync_;
  mutable config::Mutex mutex_;
  config::ConditionVariable written_;
  int descriptor_ IOTCLOUD_GUARDED_BY(mutex_);
  bool writing_ IOTCLOUD_GUARDED_BY(mutex_) = false;            ///< a thread writes to the descriptor, without the lock
  std::vector<std::string> lines_ IOTCLOUD_GUARDED_BY(mutex_);  ///< lines that no thread has begun to write
  std::uint64_t taken_ IOTCLOUD_GUARDED_BY(mutex_) = 0;         ///< number of lines passed to write()
  /// Number of lines that are on the disk or could not be written.
  std::uint64_t done_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

}  // namespace iotcloud::security
