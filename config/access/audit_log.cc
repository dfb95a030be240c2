#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/config/access/audit_log.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::config {

namespace {

constexpr Logger logger{"access"};

int open_file(const std::string& file) {
  const int descriptor = open(file.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
  if (descriptor < 0) throw Error(fmt::format("the audit log {} cannot be opened: {}", file, std::strerror(errno)));
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

}  // namespace

AuditLog::AuditLog(std::string file) : file_(std::move(file)), descriptor_(open_file(file_)) {}

AuditLog::~AuditLog() {
  close(descriptor_);
}

void AuditLog::write(const AuditEntry& entry) {
  const nlohmann::ordered_json json{{"time", iso_time(system_clock().wall_ms())},
                                    {"who", entry.who},
                                    {"role", entry.role},
                                    {"certificate", entry.certificate},
                                    {"address", entry.address},
                                    {"order", entry.order},
                                    {"what", entry.what},
                                    {"outcome", entry.outcome},
                                    {"refused", entry.refused}};
  // What clients say may be no UTF-8.
  const std::string line = json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  const std::lock_guard lock(mutex_);
  // One call, so that no line is torn, whoever else appends.
  if (::write(descriptor_, line.data(), line.size()) != static_cast<ssize_t>(line.size()) ||
      (fdatasync(descriptor_) != 0 && errno != EINVAL))
    logger.error("the audit log {} cannot be written ({}): {}", file_, std::strerror(errno), line);
}

void AuditLog::reopen() {
  const int fresh = open_file(file_);
  const std::lock_guard lock(mutex_);
  close(descriptor_);
  descriptor_ = fresh;
}

}  // namespace iotcloud::config
