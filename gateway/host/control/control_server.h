#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/gateway/host/confinement.h>
#include <iotcloud/gateway/host/control/log_file.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// The life of a driver host process: loads its plugin, listens for its gateway, does what it says, tells what happens.
class ControlServer {
 public:
  struct Options {
    HostOrder order;
    std::string plugin_path;
    bool exactly = false;     ///< the plugin is the bytes of order.identity.sha256, or it is refused
    std::string folder;       ///< the gateway's state folder
    std::string socket_name;  ///< of the socket in it
    /// A host without instances and without a gateway is of no use: it ends after this long.
    std::chrono::milliseconds orphan_limit{30000};
    LogFile::Options log;
    Confinement confinement;  ///< from when it listens on, before it loads the plugin
  };
  /// \throws config::Error when it cannot listen. A plugin that cannot be loaded is told to the gateway, and so is a
  /// confinement that cannot be.
  explicit ControlServer(Options options);
  ~ControlServer();

  /// Serves until told to shut down, or until `signals` (a signalfd) is readable; then stops all instances.
  /// \return the exit status: 0, or 1 when a driver was stuck.
  int run(int signals);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
