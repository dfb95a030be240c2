#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/logger.h>

namespace iotcloud::security {

namespace {

int open_file(const std::string& file) {
  const int descriptor = open(file.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
  if (descriptor < 0)
    throw config::Error(fmt::format("the audit log {} cannot be opened: {}", file, std::strerror(errno)));
  return descriptor;
}

std::string iso_time(std::int64_t wall_ms) {
  const std::time_t seconds = wall_ms / 1000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &utc);
  return fmt::format("{}.{:03}Z", text.data(), wall_ms % 1000);
}

bool sync_data(int descriptor) {
  return fdatasync(descriptor) == 0 || errno == EINVAL;  // a pipe cannot be synced
}

}  // namespace

AuditLog::AuditLog(std::string file, Sync sync)
    : file_(std::move(file)), sync_(sync ? std::move(sync) : sync_data), descriptor_(open_file(file_)) {}

AuditLog::~AuditLog() {
  close(descriptor_);
}

void AuditLog::write(const AuditEntry& entry) {
  const nlohmann::ordered_json json{{"time", iso_time(config::system_clock().wall_ms())},
                                    {"who", entry.who},
                                    {"role", entry.role},
                                    {"certificate", entry.certificate},
                                    {"address", entry.address},
                                    {"order", entry.order},
                                    {"what", entry.what},
                                    {"outcome", entry.outcome},
                                    {"refused", entry.refused}};
  // Text from clients may contain bytes that are not UTF-8.
  std::string line = json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  const config::MutexLock lock(mutex_);
  lines_.push_back(std::move(line));
  const std::uint64_t own = ++taken_;
  while (done_ < own) {
    if (writing_) {
      written_.wait(mutex_);
    } else {
      write_waiting();
    }
  }
}

/// Writes the lines of all waiting threads, then wakes them.
void AuditLog::write_waiting() {
  const std::vector<std::string> lines = std::exchange(lines_, {});
  const std::uint64_t last = taken_;
  const int descriptor = descriptor_;
  writing_ = true;
  {
    const config::Unlocked unlocked(mutex_);
    append(descriptor, lines);
  }
  writing_ = false;
  done_ = last;
  written_.notify_all();
}

void AuditLog::append(int descriptor, const std::vector<std::string>& lines) const noexcept {
  const auto complain = [this](const std::string& line) {
    access_logger.error("the audit log {} cannot be written ({}): {}", file_, std::strerror(errno), line);
  };
  for (const std::string& line : lines) {
    // One call, so that lines of several processes never mix.
    if (::write(descriptor, line.data(), line.size()) != static_cast<ssize_t>(line.size())) complain(line);
  }
  if (sync_(descriptor)) return;
  const int why = errno;
  for (const std::string& line : lines) {
    errno = why;
    complain(line);
  }
}

void AuditLog::reopen() {
  const int fresh = open_file(file_);
  int old = -1;
  {
    const config::MutexLock lock(mutex_);
    while (writing_) written_.wait(mutex_);
    old = std::exchange(descriptor_, fresh);
  }
  close(old);
}

std::size_t AuditLog::waiting() const {
  const config::MutexLock lock(mutex_);
  return static_cast<std::size_t>(taken_ - done_);
}

}  // namespace iotcloud::security
