#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/logger.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::security {

namespace {

using Json = nlohmann::ordered_json;

/// Limits the refusals of one identity that are written: so many at once, and then one more in each period.
constexpr double refusals_at_once = 20;
constexpr std::chrono::seconds refusal_period{3};
/// When there are more names, or more hosts without a name, than this at a time, the others of that kind share one
/// allowance.
constexpr std::size_t most_identities = 256;
/// Their place among the identities; no name and no host has a line feed.
constexpr const char* the_others = "\n";
constexpr std::size_t chunk = std::size_t{64} * 1024;

config::Error error_about(const std::string& file, const std::string& why) {
  return config::Error(fmt::format("the audit log {} cannot be opened: {}", file, why));
}

std::string iso_time(std::int64_t wall_ms) {
  const std::time_t seconds = wall_ms / 1000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &utc);
  return fmt::format("{}.{:03}Z", text.data(), wall_ms % 1000);
}

const char* name_of(AuditEvent event) {
  switch (event) {
    case AuditEvent::begun:
      return "begun";
    case AuditEvent::ended:
      return "ended";
    case AuditEvent::refused:
      return "refused";
  }
  return "";
}

bool sync_data(int descriptor) {
  return fdatasync(descriptor) == 0 || errno == EINVAL;  // a pipe cannot be synced
}

/// Reads bytes of a file. \throws Error
std::string read_at(int descriptor, off_t from, std::size_t size) {
  std::string bytes(size, '\0');
  std::size_t have = 0;
  while (have < size) {
    const auto got = pread(descriptor, bytes.data() + have, size - have, from + static_cast<off_t>(have));
    if (got <= 0) throw config::Error(fmt::format("the audit log cannot be read: {}", std::strerror(errno)));
    have += static_cast<std::size_t>(got);
  }
  return bytes;
}

off_t size_of(int descriptor) {
  struct stat status {};
  return fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode) ? status.st_size : 0;
}

/// The bytes between the last end of line before `end` and `end`.
std::string tail_before(int descriptor, off_t end) {
  std::string tail;
  while (end > 0) {
    const auto size = std::min<off_t>(end, chunk);
    const std::string part = read_at(descriptor, end - size, static_cast<std::size_t>(size));
    const auto line_end = part.rfind('\n');
    if (line_end != std::string::npos) return part.substr(line_end + 1) + tail;
    tail.insert(0, part);
    end -= size;
  }
  return tail;
}

std::string hash_of_all(int descriptor, off_t size) {
  Sha256 hash;
  for (off_t at = 0; at < size; at += chunk)
    hash.add(read_at(descriptor, at, static_cast<std::size_t>(std::min<off_t>(chunk, size - at))));
  return hash.hex();
}

bool is_same_file(int one, int other) {
  struct stat a {};
  struct stat b {};
  return fstat(one, &a) == 0 && fstat(other, &b) == 0 && a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}

}  // namespace

AuditSettings read_audit(config::YamlSection& top) {
  AuditSettings settings;
  auto audit = top.optional_section("audit");
  if (!audit) return settings;
  settings.file = audit->require_string("file");
  if (audit->choice_or("when_full", "go_on", {"go_on", "refuse"}) == "refuse")
    settings.when_full = AuditSettings::WhenFull::refuse;
  audit->finish();
  return settings;
}

AuditLog::AuditLog(AuditSettings settings, Sync sync, const config::Clock& clock)
    : settings_(std::move(settings)),
      sync_(sync ? std::move(sync) : sync_data),
      clock_(clock),
      files_(open_files(settings_.file)) {
  const config::MutexLock lock(mutex_);
  if (flock(files_.log, LOCK_EX | LOCK_NB) != 0) {
    close_files(files_);
    throw error_about(settings_.file, "another process writes it; give each daemon a file of its own");
  }
  try {
    head_ = end_of_chain(files_);
  } catch (...) {
    close_files(files_);
    throw;
  }
  access_logger.info("the audit log {} goes on after line {}", settings_.file, to_string(head_));
}

AuditLog::~AuditLog() {
  {
    const config::MutexLock lock(mutex_);
    for (auto* identities : {&named_, &strangers_}) {
      for (const auto& [identity, allowance] : std::exchange(identities->allowances, {})) tell_of_unwritten(allowance);
    }
  }
  write_lines({});
  const config::MutexLock lock(mutex_);
  close_files(files_);
}

AuditLog::Files AuditLog::open_files(const std::string& file) {
  Files files;
  files.log = open(file.c_str(), O_RDWR | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY, 0600);
  if (files.log < 0) throw error_about(file, std::strerror(errno));
  files.head = open(audit_head_file(file).c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOCTTY, 0600);
  if (files.head >= 0) return files;
  const int why = errno;
  close(files.log);
  throw error_about(audit_head_file(file), std::strerror(why));
}

void AuditLog::close_files(const Files& files) {
  close(files.log);
  close(files.head);
}

/// The line after which this process goes on. If the file does not end as FILE.head says, the chain goes on from there,
/// so that a verification finds what is missing.
AuditHead AuditLog::end_of_chain(const Files& files) const {
  off_t end = size_of(files.log);
  if (const std::string torn = tail_before(files.log, end); !torn.empty()) {
    end -= static_cast<off_t>(torn.size());
    access_logger.warn("the audit log {}: its last line was not written to its end, and is cut off: {}", settings_.file,
                       torn);
    if (ftruncate(files.log, end) != 0) throw error_about(settings_.file, std::strerror(errno));
  }
  const auto kept = read_audit_head(settings_.file);
  const std::string last = end > 0 ? tail_before(files.log, end - 1) : "";
  if (const auto link = parse_audit_link(last)) {
    AuditHead found{link->number, sha256_hex(last)};
    if (!kept || *kept == found || kept->number < found.number) return found;
  } else if (!kept) {
    return {0, hash_of_all(files.log, end)};
  }
  // An empty file: the one before was moved away.
  if (end > 0) {
    access_logger.error("the audit log {} does not end with line {}, with which it ended: somebody changed it",
                        settings_.file, kept->number);
  }
  return *kept;
}

bool AuditLog::write(const AuditEntry& entry) {
  return write_lines({text_of(entry, 0)});
}

void AuditLog::write_begun(AuditEntry entry) {
  write_begun(std::vector{std::move(entry)});
}

void AuditLog::write_begun(const std::vector<AuditEntry>& entries) {
  std::vector<std::string> texts;
  for (AuditEntry entry : entries) {
    entry.event = AuditEvent::begun;
    texts.push_back(text_of(entry, 0));
  }
  if (write_lines(std::move(texts)) || settings_.when_full == AuditSettings::WhenFull::go_on) return;
  throw config::Error(
      "the order is not carried out, because the audit log cannot be written: make room on its disk (audit: "
      "{when_full: refuse})");
}

bool AuditLog::write_refused(AuditEntry entry) {
  const auto line = count_refused(std::move(entry));
  if (line) write_all({*line});
  return line.has_value();
}

std::optional<AuditLog::Counted> AuditLog::count_refused(AuditEntry entry) {
  entry.event = AuditEvent::refused;
  const auto unwritten = due(entry);
  return unwritten ? std::optional(Counted{std::move(entry), *unwritten}) : std::nullopt;
}

void AuditLog::write_all(const std::vector<Counted>& lines) {
  std::vector<std::string> texts;
  for (const auto& line : lines) texts.push_back(text_of(line.entry, line.unwritten));
  write_lines(std::move(texts));
}

/// Counts a refusal of its identity. \return how many refusals before it have no line; nullopt: nor does this one.
std::optional<std::uint64_t> AuditLog::due(const AuditEntry& refused) {
  std::string identity = !refused.who.empty() ? refused.who : refused.address.substr(0, refused.address.rfind(':'));
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  Identities& identities = refused.who.empty() ? strangers_ : named_;
  auto& allowances = identities.allowances;
  if (allowances.size() >= most_identities && !allowances.contains(identity)) {
    forget_full(identities, now);
    if (allowances.size() >= most_identities) identity = the_others;
  }
  const auto [at, fresh] = allowances.try_emplace(identity, Allowance{refusals_at_once, now, 0, {}});
  auto& allowance = at->second;
  allowance.left = left_at(allowance, now);
  allowance.since = now;
  if (allowance.left < 1) {
    ++allowance.unwritten;
    allowance.last = refused;
    return std::nullopt;
  }
  allowance.left -= 1;
  return std::exchange(allowance.unwritten, 0);
}

double AuditLog::left_at(const Allowance& allowance, config::Clock::Instant now) {
  const std::chrono::duration<double> passed = now - allowance.since;
  return std::min(refusals_at_once, allowance.left + passed / refusal_period);
}

/// Forgets identities whose allowance is full again, as it would be if they came for the first time.
void AuditLog::forget_full(Identities& identities, config::Clock::Instant now) {
  if (now < identities.look_again) return;
  identities.look_again = now + refusal_period;  // whoever comes without end does not make this look each time
  std::erase_if(identities.allowances, [&](const auto& entry) IOTCLOUD_REQUIRES(mutex_) {
    const bool full = left_at(entry.second, now) >= refusals_at_once;
    if (full) tell_of_unwritten(entry.second);
    return full;
  });
}

/// The next lines that are written have this one before them, if there is something to tell.
void AuditLog::tell_of_unwritten(const Allowance& allowance) {
  if (allowance.unwritten > 0) overdue_.push_back(text_of(allowance.last, allowance.unwritten - 1));
}

/// The line of an entry, without its place in the chain.
std::string AuditLog::text_of(const AuditEntry& entry, std::uint64_t unwritten) const {
  Json json{{"time", iso_time(clock_.wall_ms())},
            {"event", name_of(entry.event)},
            {"who", entry.who},
            {"role", entry.role},
            {"certificate", entry.certificate},
            {"address", entry.address},
            {"order", entry.order},
            {"what", entry.what},
            {"outcome", entry.outcome},
            {"refused", entry.event == AuditEvent::refused}};
  if (unwritten > 0) json["unwritten"] = unwritten;
  // Text from clients may contain bytes that are not UTF-8.
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// \return whether all are on the disk
bool AuditLog::write_lines(std::vector<std::string> texts) {
  const config::MutexLock lock(mutex_);
  const std::uint64_t before = taken_;
  for (auto& text : std::exchange(overdue_, {})) lines_.push_back({std::move(text), ++taken_});
  for (auto& text : texts) lines_.push_back({std::move(text), ++taken_});
  const std::uint64_t last = taken_;
  while (done_ < last) {
    if (writing_) {
      written_.wait(mutex_);
    } else {
      write_waiting();
    }
  }
  const auto failed = failed_.upper_bound(before), end = failed_.upper_bound(last);
  const bool all = failed == end;
  failed_.erase(failed, end);
  return all;
}

/// Writes the lines of all waiting threads, then wakes them.
void AuditLog::write_waiting() {
  const std::vector<Line> lines = std::exchange(lines_, {});
  const std::uint64_t last = taken_;
  const Files files = files_;
  writing_ = true;
  std::set<std::uint64_t> failed;
  {
    const config::Unlocked unlocked(mutex_);
    failed = append(files, lines);
  }
  writing_ = false;
  failed_.merge(failed);
  done_ = last;
  written_.notify_all();
}

/// \return the lines that are not on the disk
std::set<std::uint64_t> AuditLog::append(const Files& files, const std::vector<Line>& lines) noexcept {
  std::set<std::uint64_t> failed;
  const auto fail = [&](const Line& line, int why) {
    access_logger.error("the audit log {} cannot be written ({}): {}", settings_.file, std::strerror(why), line.text);
    failed.insert(line.ticket);
  };
  for (const Line& line : lines) {
    if (!append_line(files, line.text)) fail(line, errno);
  }
  if (!sync_(files.log)) {
    const int why = errno;
    for (const Line& line : lines) {
      if (!failed.contains(line.ticket)) fail(line, why);
    }
  }
  // The head is written after the lines, because a head that is older than the file does no harm.
  const std::string head = fmt::format("{:<96}\n", to_string(head_));
  if (pwrite(files.head, head.data(), head.size(), 0) != static_cast<ssize_t>(head.size())) {
    access_logger.error("{} cannot be written: {}", audit_head_file(settings_.file), std::strerror(errno));
  }
  return failed;
}

/// Gives the line its place in the chain, and writes it whole or not at all.
bool AuditLog::append_line(const Files& files, const std::string& text) {
  const std::string line =
      fmt::format(R"({{"number":{},"previous":"{}",{})", head_.number + 1, head_.hash, text.substr(1));
  const off_t before = size_of(files.log);
  const std::string bytes = line + "\n";
  if (::write(files.log, bytes.data(), bytes.size()) != static_cast<ssize_t>(bytes.size())) {
    const int why = errno;
    if (size_of(files.log) > before && ftruncate(files.log, before) != 0)
      access_logger.error("the audit log {} has a line that is not whole: {}", settings_.file, std::strerror(errno));
    errno = why;
    return false;
  }
  head_ = {head_.number + 1, sha256_hex(line)};
  return true;
}

void AuditLog::reopen() {
  const Files fresh = open_files(settings_.file);
  Files old = fresh;
  {
    const config::MutexLock lock(mutex_);
    while (writing_) written_.wait(mutex_);
    if (!is_same_file(fresh.log, files_.log)) {
      if (flock(fresh.log, LOCK_EX | LOCK_NB) != 0) {
        close_files(fresh);
        throw error_about(settings_.file, "another process writes it; give each daemon a file of its own");
      }
      old = std::exchange(files_, fresh);
    }
  }
  close_files(old);
}

std::size_t AuditLog::waiting() const {
  const config::MutexLock lock(mutex_);
  return static_cast<std::size_t>(taken_ - done_);
}

}  // namespace iotcloud::security
