#pragma once

#include <cstddef>
#include <memory>
#include <thread>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/security/audit_log.h>

namespace iotcloud::gateway {

/// Writes what the registry ordered into the audit log, on a thread of its own: the disk holds up no order. Thread
/// safe.
class OrderAudit {
 public:
  explicit OrderAudit(std::shared_ptr<security::AuditLog> log);
  /// Writes what still waits.
  ~OrderAudit();
  OrderAudit(const OrderAudit&) = delete;
  OrderAudit& operator=(const OrderAudit&) = delete;

  /// Takes a line, and returns at once. When the disk is so far behind that `most_waiting` lines wait, the line is in
  /// the ordinary log only.
  void write(security::AuditEntry entry) IOTCLOUD_EXCLUDES(mutex_);

  static constexpr std::size_t most_waiting = 10'000;

 private:
  void work() IOTCLOUD_EXCLUDES(mutex_);

  const std::shared_ptr<security::AuditLog> log_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::vector<security::AuditEntry> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  bool ending_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::gateway
