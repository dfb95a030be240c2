#pragma once

#include <map>
#include <string>

#include <iotcloud/gateway/fleet/launcher.h>

namespace iotcloud::gateway {

/// Runs driver hosts inside this process: for local mode and tests. A driver that crashes takes the process with it.
class InProcessLauncher final : public HostLauncher {
 public:
  struct Options {
    std::string plugin_dir;  ///< where orders' plugins are; may be empty when all drivers are linked in
    /// Drivers that are linked in, by the name that orders give as their plugin. Looked up first; they outlive the
    /// launcher.
    std::map<std::string, const drivers::Descriptor*> linked_in;
    std::string state_dir;                 ///< for channels that are spooled to disk; empty: there can be none
    const config::Clock* clock = nullptr;  ///< nullptr: the system's
    config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  };
  explicit InProcessLauncher(Options options) : options_(std::move(options)) {}

  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override;
  std::vector<RunningHost> running(const std::string&) override { return {}; }
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override;

 private:
  const Options options_;
};

}  // namespace iotcloud::gateway
