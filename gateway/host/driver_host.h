#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

/// Runs all instances of one plugin: one event thread shared by them, or one each when the driver (or the property
/// `thread: own` of an instance) asks for it. An instance that throws or fails becomes `failed`, the others go on.
/// Thread safe. Commands return at once; what came of them is told to the listener.
class DriverHost {
 public:
  struct Options {
    std::string gateway;                          ///< id: part of the wire names
    bool isolated = false;                        ///< for one instance only (`isolation: instance`)
    std::chrono::milliseconds drain_limit{1000};  ///< for messages under way when an instance is removed
    /// Where channels with WhenFull::spool keep their messages: <state_folder>/spool/<instance>/<channel>. Empty: such
    /// a channel cannot be.
    std::string state_folder;
    const config::Clock* clock = nullptr;  ///< nullptr: the system's
    config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  };
  /// Called after every change of an instance's state, from the host's threads. Must not call back into the host.
  using Listener = std::function<void(const InstanceStatus&)>;

  DriverHost(Options options, std::shared_ptr<const Plugin> plugin, Listener listener);
  /// Stops with a limit of five seconds.
  ~DriverHost();

  /// An instance of that id that has failed is replaced; one that has not is left alone.
  void create(const InstanceSpec& spec);
  void activate(const std::string& instance);
  void deactivate(const std::string& instance);
  /// Reported as `undeployed` when done. An unknown id is reported at once.
  void remove(const std::string& instance);
  /// Removes all instances. \return false when one did not close within the limit: its thread is left behind.
  bool stop(std::chrono::milliseconds limit);

  std::vector<HostedInstance> list() const;
  const Plugin& plugin() const;
  /// The event threads that are stuck in a driver's callback. Each call also probes them, so call it regularly.
  std::vector<Stall> stalls();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
