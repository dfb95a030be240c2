#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/gateway/host/driver_host.h>

namespace iotcloud::gateway {

/// How a host ended.
struct HostEnd {
  enum class How {
    stopped,  ///< it was told to
    refused,  ///< the plugin cannot be loaded: starting it again would not help
    crashed,  ///< it died, or was killed because it hung or took too much: it may be started again
  };
  How how = How::stopped;
  std::string reason;    ///< for people; empty when it was told to
  std::string instance;  ///< whose fault it was; empty: not known
};

/// What a gateway hears of a host, on the host's or the launcher's threads; must not call back into the link.
struct HostEvents {
  std::function<void(const InstanceStatus&)> on_status;
  std::function<void(const HostEnd&)> on_ended;  ///< once, last
};

/// A gateway's hold on one driver host. Commands return at once, work in the order given, and may be given before the
/// host is up; what came of them is told by events. Thread safe.
class HostLink {
 public:
  /// No event is under way or comes after it returned. A host process lives on; one in this process is stopped.
  virtual ~HostLink() = default;
  /// What the host was started with, as far as it is known.
  virtual PluginIdentity plugin() const { return {}; }
  virtual void create(const InstanceSpec& spec) = 0;
  virtual void activate(const std::string& instance) = 0;
  virtual void deactivate(const std::string& instance) = 0;
  virtual void remove(const std::string& instance) = 0;
  /// Removes all instances and ends the host; by force when `limit` has passed. on_ended follows.
  virtual void shutdown(std::chrono::milliseconds limit) = 0;
};

/// The link to a host that could not be started; its end must be told by the launcher.
std::unique_ptr<HostLink> link_to_nothing();

/// A host found running, left by an earlier life of the gateway.
struct RunningHost {
  std::string name;  ///< the launcher's own name for it
  HostOrder order;
  std::vector<HostedInstance> instances;
};

/// Starts driver hosts: as processes of their own, or inside this one.
class HostLauncher {
 public:
  virtual ~HostLauncher() = default;
  /// Whether the plugin asks for a host for each instance (IOTCLOUD_DRIVER_ISOLATED); false for one that launch() will
  /// refuse.
  virtual bool wants_isolation(const HostOrder& order) {
    (void)order;
    return false;
  }
  /// Starts a host; returns at once. A plugin that cannot be loaded is told by on_ended (refused).
  virtual std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) = 0;
  /// Hosts that outlived an earlier gateway of this id.
  virtual std::vector<RunningHost> running(const std::string& gateway) = 0;
  /// Takes one of them over; its instances' states are told again.
  virtual std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) = 0;
};

}  // namespace iotcloud::gateway
