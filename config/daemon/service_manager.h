#pragma once

#include <chrono>
#include <string>

namespace iotcloud::config {

/// Tells systemd how this process is, when it was started by a unit of `Type=notify`; otherwise nothing happens.
/// Source: sd_notify(3), sd_watchdog_enabled(3). Used by the daemon's main thread.
class ServiceManager {
 public:
  /// Takes what the unit asks for from the environment, which children do not inherit.
  ServiceManager();

  void ready() const;
  void reloading() const;  ///< ready() says when that is over
  void stopping() const;
  /// The process still does its work, or so it believes. \param status for people, shown by `systemctl status`
  void alive(const std::string& status) const;
  /// How often alive() is due: twice in what `WatchdogSec=` allows; zero when nobody waits for it.
  std::chrono::microseconds period() const { return period_; }

 private:
  std::chrono::microseconds period_{0};
};

}  // namespace iotcloud::config
