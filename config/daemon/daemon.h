#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

namespace iotcloud::config {

/// A daemon's parts: built from its configuration file, started, stopped in order.
class Service {
 public:
  virtual ~Service() = default;
  /// Returns once the service runs (it may still be connecting). \throws Error when it cannot.
  virtual void start() = 0;
  /// Drains and stops; called once, from the main thread. Must return within `limit`.
  virtual void stop(std::chrono::milliseconds limit) = 0;
  /// SIGHUP: reads again what can change while it runs, such as who may do what. From the main thread, between start()
  /// and stop(). \throws Error: what could not be read stays as it was.
  virtual void reload() {}
  /// Why it is not well, in one line ("the registry is away"); empty: it is. Between start() and stop(), on any thread;
  /// returns soon, and takes the locks that its work takes: who waits for the answer knows that nothing hangs there.
  virtual std::string trouble() const { return {}; }
};

struct DaemonOptions {
  std::string name;         ///< "iotcloud-gateway"
  std::string description;  ///< one sentence for --help
  /// Reads and checks the whole configuration, and builds the service without starting it. \throws ConfigError.
  std::function<std::unique_ptr<Service>(const std::string& config_file)> build;
  /// From the signal to the end of the process at the latest; the service is given a little less.
  std::chrono::milliseconds stop_limit{5000};
};

/// The frame that every daemon shares: `--config FILE`, `--check-config`, `--log-level`, `--log-format`, `--version`,
/// `--help`; SIGPIPE ignored; SIGTERM and SIGINT stop in order; a second signal ends at once; SIGHUP reads the section
/// `log` of the configuration again (log_settings.h), and calls reload(). When the service runs, "NAME ready" is
/// logged, and systemd is told so; its watchdog is answered as long as trouble() returns. Blocks the signals before any
/// other thread exists, so call it first in main(). \return the exit status: 0 stopped in order, 1 failed to start or
/// to stop in time, 2 bad usage or bad configuration.
int run_daemon(int argc, char** argv, const DaemonOptions& options);

}  // namespace iotcloud::config
