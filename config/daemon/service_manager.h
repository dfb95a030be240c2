#pragma once

#include <chrono>
#include <string>

namespace iotcloud::config {

/// Reports this process's state to systemd if a unit of `Type=notify` started it; otherwise does nothing. Source:
/// sd_notify(3), sd_watchdog_enabled(3). The daemon's main thread uses it.
class ServiceManager {
 public:
  /// Takes systemd's variables out of the environment, so that child processes do not inherit them.
  ServiceManager();

  void ready() const;
  void reloading() const;  ///< ready() ends this state
  void stopping() const;
  /// Answers the watchdog: the process works. \param status for people, shown by `systemctl status`
  void alive(const std::string& status) const;
  /// How often alive() is due: twice within `WatchdogSec=`; zero if systemd does not wait for it.
  std::chrono::microseconds period() const { return period_; }

 private:
  std::chrono::microseconds period_{0};
};

}  // namespace iotcloud::config
