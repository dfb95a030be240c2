#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/child_starter.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/processes/process_settings.h>
#include <iotcloud/processes/vitals.h>
#include <iotcloud/security/plugin_versions.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/pool/worker_launcher.h>

namespace iotcloud::topology {

/// Runs each worker as a process of its own, iotcloud-topology, in the folder `STATE/workers/NAME`. It survives the
/// pool, whose next run finds it there. A worker that hangs, spins or takes too much memory is killed; that counts as a
/// crash. Workers log to `STATE/logs/TOPOLOGY/PLACE.log`, with the format and level that this process has when it
/// starts them. Thread safe.
class WorkerProcesses final : public WorkerLauncher {
 public:
  struct Options {
    discovery::PoolId pool;
    std::string state_dir;                               ///< the path of a locked StateFolder
    std::shared_ptr<processes::PluginStore> store;       ///< the component libraries that were sent; not null
    std::shared_ptr<const security::TrustedKeys> trust;  ///< of those who may sign libraries; not null
    /// A signed library runs only with a version, and not with an older one than ran here, unless its topology goes
    /// back to it (WorkerOrder::goes_back), or is named in `allow_rollback`.
    bool require_version = false;
    std::vector<std::string> allow_rollback;  ///< names by which libraries were signed
    std::string program;                      ///< empty: this process's own program
    std::chrono::milliseconds ping_period{1000};
    std::chrono::milliseconds hang_limit{10000};  ///< a worker that has not answered for this long hangs
    /// A worker in which a call of a component has not returned for this long hangs; 0: no limit.
    std::chrono::milliseconds call_limit{60000};
    std::chrono::milliseconds stop_limit{10000};  ///< until a worker that drains gives up the rest
    processes::Confinement confinement;           ///< that every worker gets; `ports` come from below
    /// The socket at which systemd starts workers under the account `confinement.user` (processes::ChildStarter).
    std::string starter;
    processes::PortsByCode ports;  ///< by topology; empty: workers connect to whatever they like
    processes::VitalLimits limits{.memory_bytes = 0, .spin = std::chrono::milliseconds{0}};
    std::vector<std::string> environment;  ///< names of variables that workers have besides the usual ones
    int log_limit_mb = 10;                 ///< the size at which a worker's log is rotated
    int logs_kept = 3;                     ///< number of older logs that are kept
  };
  /// \throws config::Error if a folder cannot be made, or nobody starts workers under their account.
  explicit WorkerProcesses(Options options);

  std::unique_ptr<WorkerLink> start(const WorkerOrder& order, WorkerEvents events) override;
  std::vector<RunningWorker> running() override;
  std::unique_ptr<WorkerLink> adopt(const RunningWorker& worker, WorkerEvents events) override;

  /// The log of a place's workers in a state folder.
  static std::string log_of(const std::string& state_folder, const discovery::PlaceId& place);

 private:
  std::string folder_of(const std::string& name) const { return options_.state_dir + "/workers/" + name; }
  processes::LogFile::Options log_file(const discovery::PlaceId& place) const;
  void prepare(const std::string& folder, const WorkerOrder& order, const pooled::WorkerSpec& spec) const;
  processes::ChildProcess launch(const std::string& folder, const pooled::WorkerSpec& spec) const;
  std::unique_ptr<WorkerLink> link(const std::string& folder, const discovery::PlaceId& place,
                                   processes::ChildProcess process, WorkerEvents events) const;
  pooled::WorkerConfinement confinement_in(const std::string& folder, const discovery::TopologyName& topology) const;
  std::string checked_library(const discovery::SentLibrary& library, bool goes_back);
  std::optional<RunningWorker> examine(const std::string& name) const;

  const Options options_;
  const processes::ChildStarter starter_;
  std::optional<security::PluginVersions> versions_;  ///< nullopt: they are not looked at
};

}  // namespace iotcloud::topology
