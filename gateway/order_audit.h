#pragma once

#include <memory>
#include <thread>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/security/audit_log.h>

namespace iotcloud::gateway {

/// Writes what the registry ordered into the audit log: that an order is about to be followed before it is, and the
/// rest on a thread of its own, so that refusals hold up no order. Thread safe.
class OrderAudit {
 public:
  explicit OrderAudit(std::shared_ptr<security::AuditLog> log);
  /// Writes what still waits.
  ~OrderAudit();
  OrderAudit(const OrderAudit&) = delete;
  OrderAudit& operator=(const OrderAudit&) = delete;

  /// Writes that these orders are about to be followed; returns when that is on the disk. \throws config::Error if they
  /// must not be followed (security::AuditLog::write_begun())
  void begin(const std::vector<security::AuditEntry>& orders);
  /// Takes the line of an order that was followed, or refused, and returns at once. Of refusals it takes no more than
  /// the log writes.
  void write(security::AuditEntry entry) IOTCLOUD_EXCLUDES(mutex_);

 private:
  void work() IOTCLOUD_EXCLUDES(mutex_);

  const std::shared_ptr<security::AuditLog> log_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::vector<security::AuditLog::Counted> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  bool ending_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::gateway
