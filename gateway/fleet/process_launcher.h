#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/gateway/fleet/broker_files.h>
#include <iotcloud/gateway/fleet/host_brokers.h>
#include <iotcloud/gateway/fleet/host_metrics.h>
#include <iotcloud/gateway/fleet/host_proofs.h>
#include <iotcloud/gateway/fleet/host_troubles.h>
#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/fleet/plugin_source.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/child_starter.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/places.h>
#include <iotcloud/processes/process_settings.h>
#include <iotcloud/processes/vitals.h>
#include <iotcloud/security/plugin_versions.h>

namespace iotcloud::gateway {

/// Runs each driver host as a separate process, iotcloud-driver-host. It survives the gateway, whose next run finds it
/// by its socket in the state folder. The launcher kills a host that hangs, spins or takes too much memory; that counts
/// as a crash. Hosts log to `STATE/logs/PLUGIN.log` (older logs: `PLUGIN.log.1` and so on), with the format and level
/// that this process has when it starts the host.
class ProcessLauncher final : public HostLauncher {
 public:
  /// TCP ports by the plugin whose hosts may connect to them.
  using Ports = processes::PortsByCode;
  struct Options {
    std::string plugin_dir;
    std::shared_ptr<processes::PluginStore> store;       ///< the uploaded plugins; null: there are none
    std::shared_ptr<const security::TrustedKeys> trust;  ///< null: no signature is required
    bool trust_folder = false;                           ///< as in PluginSource()
    std::vector<std::string> allow_rollback;             ///< as in security::PluginVersions
    bool require_version = false;                        ///< as in security::PluginVersions
    std::string state_dir;                               ///< the path of a locked StateFolder
    std::string host_program;  ///< empty: iotcloud-driver-host beside this process's own program
    std::chrono::milliseconds ping_period{1000};
    /// A host hangs if its control thread or its shared event thread is stuck for `hang_limit`, or if an instance's own
    /// event thread (`thread: own`) is stuck for `own_thread_hang_limit`.
    std::chrono::milliseconds hang_limit{10000};
    std::chrono::milliseconds own_thread_hang_limit{60000};
    processes::VitalLimits limits;
    processes::Confinement confinement;
    /// The places to which hosts may connect, by their plugins; empty: whatever they like, unless a deployment says
    /// something else. A deployment may leave some out, and add none.
    processes::PlacesByCode network;
    std::vector<processes::Place> brokers_places;  ///< the brokers' servers, which every list of places has
    std::vector<std::string> broker_files;         ///< of which hosts with Confinement::files read copies
    Ports ports;  ///< empty: hosts connect to whatever they like; otherwise each has some, see Confinement::ports
    /// The socket at which systemd starts hosts under the account `confinement.user` (processes::ChildStarter).
    std::string starter;
    std::vector<std::string> environment;  ///< names of variables that hosts have besides the usual ones
    int log_limit_mb = 10;                 ///< the size at which a host's log is rotated
    int logs_kept = 3;                     ///< number of older logs that are kept
    std::shared_ptr<HostBrokers> brokers;  ///< gets the hosts' brokers with each answer to a ping; null: nobody does
    std::shared_ptr<HostTroubles> troubles{};  ///< gets with it which instances hang or lose messages; null: nobody
    /// Gets the hosts' metrics every `metrics_period`; null: they are not collected.
    std::shared_ptr<HostMetrics> metrics;
    std::chrono::milliseconds metrics_period{2000};
  };
  /// \throws config::Error if the host program or a folder is missing, or this machine cannot confine hosts as
  /// configured.
  explicit ProcessLauncher(Options options);

  /// The folder of the hosts' logs in a state folder.
  static std::string log_folder(const std::string& state_folder);

  bool wants_isolation(const HostOrder& order) override;
  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override;
  std::vector<discovery::KnownPlugin> plugins(const std::map<std::string, std::string>& names) override {
    return source_.all(names);
  }
  std::vector<RunningHost> running(const discovery::GatewayId& gateway) override;
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override;
  /// Gives confined hosts what has replaced a broker's file (BrokerFiles::renew()).
  void renew_broker_files();

 private:
  std::optional<std::vector<processes::Place>> network_of(const HostOrder& order) const;
  std::vector<processes::Place> with_brokers(std::vector<processes::Place> places) const;
  std::string network_text(const HostOrder& order) const;
  processes::LogFile::Options log_of(const std::string& plugin) const;

  Options options_;
  PluginSource source_;
  security::PluginVersions versions_;
  const HostProofs proofs_;
  const processes::ChildStarter starter_;
  std::shared_ptr<BrokerFiles> broker_files_;  ///< null: hosts are not confined to files, and read the files themselves
};

}  // namespace iotcloud::gateway
