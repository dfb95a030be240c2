#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>

namespace iotcloud::config {

/// A daemon's parts: built from its configuration file, started, and stopped in order.
class DaemonService {
 public:
  virtual ~DaemonService() = default;
  /// Returns once the service runs (it may still be connecting), or, if it waits for something, soon after another
  /// thread asked for a stop: then the service may not run, and stop() is next. \throws Error if it cannot start.
  virtual void start(const std::stop_token& stop) = 0;
  /// A start that nobody cuts short.
  void start() { start({}); }
  /// Drains and stops. The main thread calls it once, after start(); it must return within `limit`.
  virtual void stop(std::chrono::milliseconds limit) = 0;
  /// Called on SIGHUP: reads again what may change while the service runs, such as tokens. The main thread calls it
  /// between start() and stop(). \throws Error if it cannot read something, whose old value then stays; the rest is
  /// read.
  virtual void reload() {}
  /// Why the service is unhealthy, in one line ("the registry is away"); empty if it is healthy. Any thread may call it
  /// between start() and stop(). It must return soon, and must take the locks that the service's work takes, so that an
  /// answer proves that the work does not hang.
  virtual std::string trouble() const { return {}; }
};

/// The description of one daemon: its name, and how its service is made.
struct DaemonOptions {
  std::string name;         ///< "iotcloud-gateway"
  std::string description;  ///< one sentence for --help
  /// Reads and checks the whole configuration, and builds the service without starting it. \throws ConfigError.
  std::function<std::unique_ptr<DaemonService>(const std::string& config_file)> build;
  /// Longest time from the signal to the end of the process, unless the command line says another one; the service gets
  /// a little less.
  std::chrono::milliseconds stop_limit{5000};
};

/// The frame that every daemon shares: `--config FILE`, `--check-config`, `--log-level`, `--log-format`,
/// `--stop-limit`, `--version`, `--help`. It ignores SIGPIPE; SIGTERM and SIGINT stop the service in order, also while
/// it starts, and a second signal ends the process at once; SIGHUP reads the section `log` of the configuration again
/// (log_settings.h) and calls reload(). When the service runs, it logs "NAME ready" and tells systemd; it answers
/// systemd's watchdog as long as trouble() returns. It blocks the signals before any other thread starts, so call it
/// first in main(). \return the exit status: 0 stopped in order, 1 failed to start or to stop in time, 2 wrong
/// arguments or bad configuration.
int run_daemon(int argc, char** argv, const DaemonOptions& options);

}  // namespace iotcloud::config
