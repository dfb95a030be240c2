#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/discovery/known_plugin.h>
#include <iotcloud/gateway/host/driver_host.h>

namespace iotcloud::gateway {

/// How a host ended.
struct HostEnd {
  /// Whether it may be started again.
  enum class How {
    stopped,  ///< it was told to stop
    refused,  ///< the plugin cannot be loaded: starting it again would not help
    crashed,  ///< it died, or was killed because it hung or took too much: it may be started again
  };
  How how = How::stopped;
  std::string reason;              ///< for people; empty if it was told to stop
  discovery::InstanceId instance;  ///< the instance at fault; empty: not known
};

/// A host's events. The functions run on threads of the host or the launcher, and must not call back into the link.
struct HostEvents {
  std::function<void(const InstanceStatus&)> on_status;
  std::function<void(const HostEnd&)> on_ended;  ///< called once, after all other events
  /// The host has read a message for an instance that it does not run; HostLink::answer() must follow. May be empty.
  std::function<void(const PassedMessage&)> on_pass{};
  /// Called with the outcome of a message of HostLink::deliver(). May be empty.
  std::function<void(std::int64_t number, PassAnswer)> on_answer{};
  /// The answer to HostLink::ask(). May be empty.
  std::function<void(std::int64_t number, discovery::ChannelLook)> on_told{};
  /// What an instance that is a finder tells. May be empty.
  std::function<void(FoundReport)> on_found{};
};

/// A gateway's handle on one driver host. Commands return at once, are carried out in the order given, and may be given
/// before the host has started. Events report their outcome. Thread safe.
class HostLink {
 public:
  /// When it has returned, no event function runs or will run. A host process goes on; a host inside this process is
  /// stopped.
  virtual ~HostLink() = default;
  /// Which plugin bytes the host was started with, as far as that is known.
  virtual PluginIdentity plugin() const { return {}; }
  virtual void create(const InstanceSpec& spec) = 0;
  virtual void activate(const discovery::InstanceId& instance) = 0;
  virtual void deactivate(const discovery::InstanceId& instance) = 0;
  /// \param removal see DriverHost::remove()
  virtual void remove(const discovery::InstanceId& instance, Removal removal) = 0;
  /// Hands the host a message that another host has passed; on_answer follows, unless the host ends.
  virtual void deliver(const PassedMessage& passed) { static_cast<void>(passed); }
  /// Tells the host what became of a message that it has passed.
  virtual void answer(std::int64_t number, PassAnswer answer) {
    static_cast<void>(number);
    static_cast<void>(answer);
  }
  /// The registry confirmed the gateway's place at that time (DriverHost::renew()); an older confirmation may be told
  /// again.
  virtual void renew(config::Clock::Instant confirmed) { static_cast<void>(confirmed); }
  /// Looks at a channel, or hands an instance a message; on_told follows with that number, unless the host ends.
  virtual void ask(std::int64_t number, const ChannelQuestion& question) {
    static_cast<void>(number);
    static_cast<void>(question);
  }
  /// Removes all instances and ends the host, by force when `limit` has passed. Then calls on_ended.
  virtual void shutdown(std::chrono::milliseconds limit) = 0;
};

/// The link to a host that could not be started. Its commands do nothing, and the launcher must call on_ended.
std::unique_ptr<HostLink> link_to_nothing();

/// A running host that an earlier run of the gateway left behind.
struct RunningHost {
  std::string name;  ///< the launcher's own name for it
  HostOrder order;
  std::vector<HostedInstance> instances;
};

/// Starts driver hosts, as separate processes or inside this process.
class HostLauncher {
 public:
  virtual ~HostLauncher() = default;
  /// Whether the plugin asks for a host for each instance (IOTCLOUD_DRIVER_ISOLATED); false for one that launch() will
  /// refuse.
  virtual bool wants_isolation(const HostOrder& order) {
    (void)order;
    return false;
  }
  /// Starts a host; returns at once. If the plugin cannot be loaded, on_ended reports `refused`.
  virtual std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) = 0;
  /// The plugins that launch() would find. They are read, not loaded. \param names by SHA-256: how orders call a plugin
  /// that was sent
  virtual std::vector<discovery::KnownPlugin> plugins(const std::map<std::string, std::string>& names) {
    static_cast<void>(names);
    return {};
  }
  /// Hosts that outlived an earlier gateway of this id.
  virtual std::vector<RunningHost> running(const discovery::GatewayId& gateway) = 0;
  /// Adopts one of these hosts; on_status reports the states of its instances again.
  virtual std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) = 0;
};

}  // namespace iotcloud::gateway
