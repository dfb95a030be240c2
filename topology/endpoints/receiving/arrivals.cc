#include <utility>

#include <iotcloud/topology/endpoints/receiving/arrivals.h>

namespace iotcloud::topology {

void Arrivals::look(Backlog backlog) {
  const std::int64_t oldest = oldest_ms_.exchange(none, std::memory_order_relaxed);
  const config::MutexLock lock(mutex_);
  if (oldest != none) facts_.age_ms = oldest;
  facts_.backlog = std::move(backlog);
}

Arrivals::Facts Arrivals::facts() const {
  const config::MutexLock lock(mutex_);
  return facts_;
}

void Arrivals::set_units(ReadUnits units) {
  const config::MutexLock lock(mutex_);
  units_ = std::move(units);
}

ReadUnits Arrivals::units() const {
  const config::MutexLock lock(mutex_);
  return units_;
}

}  // namespace iotcloud::topology
