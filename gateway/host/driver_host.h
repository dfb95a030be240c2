#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/broker_states.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/found_things.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/losing_channel.h>
#include <iotcloud/gateway/host/passed_message.h>
#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

/// Runs all instances of one plugin: on one shared event thread, or on a thread of its own for an instance whose
/// driver, or whose property `thread: own`, asks for it. An instance that throws or fails becomes `failed`, the others
/// go on. Thread safe. Commands return at once; the listener gets their outcome.
class DriverHost {
 public:
  struct Options {
    discovery::GatewayId gateway;                 ///< part of the channels' wire names
    bool isolated = false;                        ///< the host runs one instance only (`isolation: instance`)
    std::chrono::milliseconds drain_limit{1000};  ///< how long a removed instance's unconfirmed messages may take
    /// Where channels with WhenFull::spool keep their messages: `<state_folder>/spool/<instance>/<channel>`. Empty:
    /// such a channel is refused.
    std::string state_folder;
    Passing passing{};  ///< to and from the gateway's other hosts of the driver
    /// Called with what finders tell, on the instances' event threads; the reports of one finder are in order. Must not
    /// call back into the host. May be empty.
    std::function<void(FoundReport)> on_found{};
    const config::Clock* clock = nullptr;  ///< nullptr: the system's
    config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  };
  /// Called after every change of an instance's state, from the host's threads. Must not call back into the host.
  using Listener = std::function<void(const InstanceStatus&)>;

  DriverHost(const Options& options, std::shared_ptr<const Plugin> plugin, Listener listener);
  /// Calls stop() with a limit of five seconds.
  ~DriverHost();

  /// Replaces a failed instance with the same id; does nothing if that instance has not failed.
  void create(const InstanceSpec& spec);
  void activate(const discovery::InstanceId& instance);
  void deactivate(const discovery::InstanceId& instance);
  /// Begins to remove the instance; the listener gets `undeployed` when it has ended, and at once for an unknown id.
  /// With Removal::undeployed the broker's queues of the instance's own incoming channels are removed, too
  /// (brokers::Broker::remove_queue()).
  void remove(const discovery::InstanceId& instance, Removal removal);
  /// Removes all instances. \return false when one did not end within the limit: left_behind() says why. The thread of
  /// a driver that is stuck in a callback is left behind.
  bool stop(std::chrono::milliseconds limit);
  std::string left_behind() const;

  /// Hands a message that another host has passed to its instance. Passing::answer says later, on any thread, what
  /// became of it.
  void deliver(PassedMessage passed);
  /// Reports the outcome of a message that this host has passed.
  void answered(std::int64_t number, PassAnswer answer);
  /// The gateway is gone: messages that were passed and not answered wait here again.
  void nobody_answers();

  /// The registry confirmed the gateway's place when the gateway asked at `confirmed` (this machine's monotonic clock).
  /// Instances that stopped for the lack of it start again.
  void renew(config::Clock::Instant confirmed);
  /// Stops the instances whose lease (`gateway/host/lease.h`) has run out. Call it regularly, and when the time that it
  /// returns has passed. \return until the next lease runs out; nullopt: none does.
  std::optional<std::chrono::milliseconds> enforce_leases();

  /// Looks at a channel of an instance, or hands the instance a message. \param done called once, on any thread,
  /// perhaps before this function returns
  void ask(ChannelQuestion question, const std::function<void(discovery::ChannelLook)>& done);

  /// Has all finders tell all that they find once more: there is a gateway that knows nothing of it.
  void tell_found();

  /// The brokers that instances use. Looks at them; call it regularly, because that is how exact BrokerLink::since_ms
  /// is.
  std::vector<BrokerLink> brokers();
  /// The channels that lose messages. Call it regularly, because it finds what has been lost since the last call.
  std::vector<LosingChannel> losing();
  std::vector<HostedInstance> list() const;
  const Plugin& plugin() const;
  /// The event threads that are stuck in a driver's callback. Each call also probes them, so call it regularly.
  std::vector<Stall> stalls();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
