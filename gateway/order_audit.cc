#include <utility>

#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/order_audit.h>

namespace iotcloud::gateway {

OrderAudit::OrderAudit(std::shared_ptr<security::AuditLog> log) : log_(std::move(log)), thread_([this] { work(); }) {}

OrderAudit::~OrderAudit() {
  {
    const config::MutexLock lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void OrderAudit::write(security::AuditEntry entry) {
  {
    const config::MutexLock lock(mutex_);
    if (waiting_.size() >= most_waiting) {
      logger.error("the audit log is too far behind for a line: {} {}: {}", entry.order, entry.what, entry.outcome);
      return;
    }
    waiting_.push_back(std::move(entry));
  }
  changed_.notify_all();
}

void OrderAudit::work() {
  for (;;) {
    std::vector<security::AuditEntry> entries;
    {
      const config::MutexLock lock(mutex_);
      while (waiting_.empty() && !ending_) changed_.wait(mutex_);
      if (waiting_.empty()) return;
      entries.swap(waiting_);
    }
    log_->write_all(entries);
  }
}

}  // namespace iotcloud::gateway
