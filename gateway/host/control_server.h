#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/log_file.h>

namespace iotcloud::gateway {

/// Runs a driver host process: loads the plugin, listens for the gateway, carries out its commands and sends it
/// reports.
class ControlServer {
 public:
  struct Options {
    HostOrder order;
    std::string plugin_path;
    bool exactly = false;     ///< refuse the plugin unless its bytes have the SHA-256 order.identity.sha256
    std::string folder;       ///< the gateway's state folder
    std::string socket_name;  ///< the name of the socket in that folder
    std::string proof_check;  ///< the SHA-256 of what the gateway must show (HostProofs)
    int socket = -1;          ///< a descriptor of that socket, made by the gateway; -1: this process makes it
    /// A host that has neither instances nor a gateway ends after this time.
    std::chrono::milliseconds orphan_limit{30000};
    processes::LogFile::Options log;
    processes::Confinement confinement;  ///< applied after the host listens and before it loads the plugin
  };
  /// \throws config::Error if it cannot listen. If the plugin cannot be loaded or the process cannot be confined, it
  /// reports that to the gateway instead of throwing.
  explicit ControlServer(Options options);
  ~ControlServer();

  /// Serves until the gateway orders a shutdown or `signals` (a signalfd) is readable, then stops all instances.
  /// \return the exit status: 0, or 1 when a driver was stuck.
  int run(int signals);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
