#pragma once

#include <map>
#include <string>

#include <iotcloud/gateway/fleet/launcher.h>

namespace iotcloud::gateway {

/// Runs driver hosts inside this process, for local mode and tests. A driver that crashes ends this process.
class InProcessLauncher final : public HostLauncher {
 public:
  struct Options {
    std::string plugin_dir;  ///< the folder of the plugins that orders name; may be empty if all drivers are linked in
    /// Linked-in drivers, by the plugin name that orders use for them. They take precedence over `plugin_dir`, and
    /// outlive the launcher.
    std::map<std::string, const drivers::Descriptor*> linked_in;
    std::string state_dir;  ///< the folder for spools; empty: a channel with `when_full: spool` is refused
    const config::Clock* clock = nullptr;  ///< nullptr: the system's
    config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  };
  explicit InProcessLauncher(Options options) : options_(std::move(options)) {}

  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override;
  std::vector<RunningHost> running(const discovery::GatewayId&) override { return {}; }
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override;

 private:
  const Options options_;
};

}  // namespace iotcloud::gateway
