#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/host/confinement.h>
#include <iotcloud/gateway/plugins/plugin_source.h>
#include <iotcloud/gateway/processes/host_account.h>
#include <iotcloud/gateway/processes/host_metrics.h>
#include <iotcloud/gateway/processes/vitals.h>

namespace iotcloud::gateway {

/// Runs each driver host as a process of its own, iotcloud-driver-host, detached: it survives the gateway and is found
/// again by its socket in the state folder. A host that hangs, spins or takes too much memory is killed and counts as
/// crashed. What hosts log goes to <state folder>/<plugin>.log, older ones are <plugin>.log.1 and so on, in the format
/// and from the level on that this process has when it starts the host.
class ProcessLauncher final : public HostLauncher {
 public:
  struct Options {
    std::string plugin_dir;
    std::shared_ptr<PluginStore> store;        ///< of plugins that are sent; null: there are none
    std::shared_ptr<const PluginTrust> trust;  ///< null: no signature is asked for
    std::string state_dir;                     ///< of a locked StateFolder
    std::string host_program;                  ///< empty: iotcloud-driver-host beside this process's own program
    std::chrono::milliseconds ping_period{1000};
    /// A host whose control thread, or shared event thread, has not come round for this long hangs; so does one with an
    /// instance that has not come back to its own thread (`thread: own`) for so long.
    std::chrono::milliseconds hang_limit{10000};
    std::chrono::milliseconds own_thread_hang_limit{60000};
    VitalLimits limits;
    Confinement confinement;
    int log_limit_mb = 10;  ///< a host's log, before a new one is begun
    int logs_kept = 3;      ///< older ones
    /// Where the hosts' metrics go, each `metrics_period`; null: nowhere.
    std::shared_ptr<HostMetrics> metrics;
    std::chrono::milliseconds metrics_period{2000};
  };
  /// \throws config::Error when the host program or a folder is not there, or hosts cannot be confined so.
  explicit ProcessLauncher(Options options);

  bool wants_isolation(const HostOrder& order) override;
  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override;
  std::vector<RunningHost> running(const std::string& gateway) override;
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override;

 private:
  LogFile::Options log_of(const std::string& plugin) const;
  /// What keeps the log of that plugin's hosts within bounds, when they may not do it themselves; otherwise empty.
  std::function<void()> log_keeper(const std::string& plugin) const;

  Options options_;
  std::shared_ptr<const HostAccount> account_;  ///< null: they run as this process does
  PluginSource source_;
};

}  // namespace iotcloud::gateway
