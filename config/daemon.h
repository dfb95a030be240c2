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
};

struct DaemonOptions {
  std::string name;         ///< "iotcloud-gateway"
  std::string description;  ///< one sentence for --help
  /// Reads and checks the whole configuration, and builds the service without starting it. \throws ConfigError.
  std::function<std::unique_ptr<Service>(const std::string& config_file)> build;
  /// From the signal to the end of the process at the latest; the service is given a little less.
  std::chrono::milliseconds stop_limit{5000};
};

/// The frame that every daemon shares: `--config FILE`, `--check-config`, `--log-level`, `--version`, `--help`; SIGPIPE
/// ignored; SIGTERM and SIGINT stop in order; a second signal ends at once. When the service runs, "NAME ready" is
/// logged. Blocks the signals before any other thread exists, so call it first in main().
/// \return the exit status: 0 stopped in order, 1 failed to start or to stop in time, 2 bad usage or bad configuration.
int run_daemon(int argc, char** argv, const DaemonOptions& options);

}  // namespace iotcloud::config
