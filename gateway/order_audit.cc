#include <optional>
#include <utility>

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

void OrderAudit::begin(const std::vector<security::AuditEntry>& orders) {
  log_->write_begun(orders);
}

void OrderAudit::write(security::AuditEntry entry) {
  auto line = entry.event == security::AuditEvent::refused
                  ? log_->count_refused(std::move(entry))
                  : std::optional(security::AuditLog::Counted{std::move(entry), 0});
  if (!line) return;
  {
    const config::MutexLock lock(mutex_);
    waiting_.push_back(*std::move(line));
  }
  changed_.notify_all();
}

void OrderAudit::work() {
  for (;;) {
    std::vector<security::AuditLog::Counted> lines;
    {
      const config::MutexLock lock(mutex_);
      while (waiting_.empty() && !ending_) changed_.wait(mutex_);
      if (waiting_.empty()) return;
      lines.swap(waiting_);
    }
    log_->write_all(lines);
  }
}

}  // namespace iotcloud::gateway
