#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/security/audit_chain.h>

namespace iotcloud::security {

/// The kinds of lines of the audit log.
enum class AuditEvent {
  begun,    ///< an order that is about to be carried out
  ended,    ///< what became of an order
  refused,  ///< a call of somebody who was not authenticated, or not allowed
};

/// One line of the audit log: who did what, with which outcome.
struct AuditEntry {
  AuditEvent event = AuditEvent::ended;
  std::string who;          ///< the token's name, or "user anna" where no token is asked for; empty: not known
  std::string role;         ///< "operator"
  std::string certificate;  ///< "CN=operator"; empty without TLS
  std::string address;      ///< "192.0.2.7:40112"
  std::string order;        ///< the method: "deploy"
  std::string what;         ///< "turtle.so on lab1"
  std::string outcome;      ///< "done", or the reason of the failure; empty while it is not known
};

/// Where a daemon writes down orders, and what it does when it cannot.
struct AuditSettings {
  /// The policies for an order whose line cannot be written (a full disk).
  enum class WhenFull {
    go_on,   ///< it is carried out; the ordinary log has an error and the line
    refuse,  ///< it is refused
  };
  std::string file;  ///< empty: no audit log
  WhenFull when_full = WhenFull::go_on;
};

/// Reads `audit: {file, when_full}`. Without the section: no audit log. \throws ConfigError
AuditSettings read_audit(config::YamlSection& top);

/// A file of orders: a JSON object on each line with `number` and `previous` (audit_chain.h), `time` (ISO 8601, UTC),
/// `event` and the members of AuditEntry. A line is on disk before write() returns, so the log survives a crash of the
/// machine right after the order. Lines that are added while the disk is busy are synced together. Refusals are
/// limited: of one identity 20 at once and then one in 3 s are written; the next line that is written says how many
/// were not
/// (`unwritten`). Thread safe.
class AuditLog {
 public:
  /// Syncs what was written to the disk; runs without a lock, and must not throw. \return false if that failed; errno
  /// says why
  using Sync = std::function<bool(int descriptor)>;
  /// Appends to the file; if it makes the file, only the owner may read it. Cuts off a last line that a crash left
  /// unfinished. \param sync empty: fdatasync. \throws Error if it cannot open the file, or another process writes it.
  explicit AuditLog(AuditSettings settings, Sync sync = {}, const config::Clock& clock = config::system_clock());
  explicit AuditLog(const std::string& file, Sync sync = {}) : AuditLog(AuditSettings{file, {}}, std::move(sync)) {}
  /// Writes how many refusals had no line.
  ~AuditLog();
  AuditLog(const AuditLog&) = delete;
  AuditLog& operator=(const AuditLog&) = delete;

  /// Writes a line, and returns when it is on the disk; logs an error if it cannot (a full disk).
  /// \return whether it is on the disk
  bool write(const AuditEntry& entry) IOTCLOUD_EXCLUDES(mutex_);
  /// Writes that an order is about to be carried out. \throws Error if it cannot, and the settings say `refuse`: then
  /// the caller must not carry it out.
  void write_begun(AuditEntry entry) IOTCLOUD_EXCLUDES(mutex_);
  /// The same of several orders, with one wait for the disk: if one line cannot be written, none may be carried out.
  void write_begun(const std::vector<AuditEntry>& entries) IOTCLOUD_EXCLUDES(mutex_);
  /// Writes a refusal, within the limit of its identity: the token's name, or the address's host.
  /// \return whether it was written
  bool write_refused(AuditEntry entry) IOTCLOUD_EXCLUDES(mutex_);
  /// A line for write_all().
  struct Counted {
    AuditEntry entry;
    std::uint64_t unwritten = 0;  ///< so many refusals before it have no line
  };
  /// Counts a refusal within the limit of its identity, and does not wait for the disk. \return what to write; nullopt:
  /// nothing
  std::optional<Counted> count_refused(AuditEntry entry) IOTCLOUD_EXCLUDES(mutex_);
  /// Writes all these lines as write() does, with one wait for the disk.
  void write_all(const std::vector<Counted>& lines) IOTCLOUD_EXCLUDES(mutex_);
  /// Opens the file by its name again, after somebody renamed the old file. When it has returned, nothing is written to
  /// the old file any more. \throws Error, and keeps the old one.
  void reopen() IOTCLOUD_EXCLUDES(mutex_);
  /// How many lines are not on the disk yet.
  std::size_t waiting() const IOTCLOUD_EXCLUDES(mutex_);

 private:
  struct Files {
    int log = -1;   ///< locked against other writers
    int head = -1;  ///< the file of audit_head_file()
  };
  struct Line {
    std::string text;  ///< without its place in the chain
    std::uint64_t ticket = 0;
  };
  /// How many refusals of one identity may still be written.
  struct Allowance {
    double left = 0;
    config::Clock::Instant since;
    std::uint64_t unwritten = 0;
    AuditEntry last;  ///< the last one that was not written
  };
  /// Those with a name and those without one are counted apart: however many hosts a stranger has, they take no name's
  /// place.
  struct Identities {
    std::map<std::string, Allowance> allowances;
    config::Clock::Instant look_again;  ///< when allowances that are full may be looked for next
  };

  static Files open_files(const std::string& file);
  static void close_files(const Files& files);
  AuditHead end_of_chain(const Files& files) const;
  std::optional<std::uint64_t> due(const AuditEntry& refused) IOTCLOUD_EXCLUDES(mutex_);
  static double left_at(const Allowance& allowance, config::Clock::Instant now);
  void forget_full(Identities& identities, config::Clock::Instant now) IOTCLOUD_REQUIRES(mutex_);
  void tell_of_unwritten(const Allowance& allowance) IOTCLOUD_REQUIRES(mutex_);
  std::string text_of(const AuditEntry& entry, std::uint64_t unwritten) const;
  bool write_lines(std::vector<std::string> texts) IOTCLOUD_EXCLUDES(mutex_);
  void write_waiting() IOTCLOUD_REQUIRES(mutex_);
  std::set<std::uint64_t> append(const Files& files, const std::vector<Line>& lines) noexcept IOTCLOUD_EXCLUDES(mutex_);
  bool append_line(const Files& files, const std::string& text);

  const AuditSettings settings_;
  const Sync sync_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  config::ConditionVariable written_;
  Files files_ IOTCLOUD_GUARDED_BY(mutex_);
  bool writing_ IOTCLOUD_GUARDED_BY(mutex_) = false;     ///< a thread writes to the files, without the lock
  std::vector<Line> lines_ IOTCLOUD_GUARDED_BY(mutex_);  ///< lines that no thread has begun to write
  std::uint64_t taken_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< number of lines passed to write()
  /// Number of lines that are on the disk or could not be written.
  std::uint64_t done_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::set<std::uint64_t> failed_ IOTCLOUD_GUARDED_BY(mutex_);  ///< lines that could not be written, until told
  AuditHead head_;  ///< the last line of the file; used by the thread that set `writing_`
  Identities named_ IOTCLOUD_GUARDED_BY(mutex_);
  Identities strangers_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<std::string> overdue_ IOTCLOUD_GUARDED_BY(mutex_);  ///< tell_of_unwritten()
};

}  // namespace iotcloud::security
