#include "iotcloud/config/daemon/service_manager.h"

#include <cstdint>

#include <systemd/sd-daemon.h>

namespace iotcloud::config {

ServiceManager::ServiceManager() {
  std::uint64_t limit_us = 0;
  if (sd_watchdog_enabled(1, &limit_us) > 0) period_ = std::chrono::microseconds(limit_us / 2);
}

void ServiceManager::ready() const {
  sd_notify(0, "READY=1\nSTATUS=running");
}

void ServiceManager::reloading() const {
  sd_notify(0, "RELOADING=1");
}

void ServiceManager::stopping() const {
  sd_notify(0, "STOPPING=1\nSTATUS=stopping");
}

void ServiceManager::alive(const std::string& status) const {
  sd_notifyf(0, "WATCHDOG=1\nSTATUS=%s", status.c_str());
}

}  // namespace iotcloud::config
