#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/fleet/placement.h>
#include <iotcloud/gateway/ordered_instances.h>
#include <iotcloud/gateway/provisioning/rules.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::gateway {

/// A gateway's settings, and the objects that it uses.
struct GatewayOptions {
  discovery::GatewayId id;
  std::string host = "127.0.0.1";  ///< the host under which others reach the gateway's Thrift service
  int port = 0;                    ///< the port of the Thrift service; 0: the gateway has none
  bool tls = false;                ///< whether the Thrift service uses TLS
  std::vector<brokers::BrokerSetting> brokers;
  discovery::Registry* registry = nullptr;  ///< not null; outlives the gateway
  discovery::Paths paths;
  std::shared_ptr<HostLauncher> launcher;  ///< not null
  /// The store of uploaded plugins; null: the gateway takes no uploads.
  std::shared_ptr<processes::PluginStore> plugins;
  /// The masters whose orders are followed; null: every order that stands in the registry.
  std::shared_ptr<const security::TrustedKeys> order_keys;
  /// Where signed orders of the registry that are followed, and those that are refused, are written; null: in the
  /// ordinary log only.
  std::shared_ptr<security::AuditLog> audit;
  std::string followed_file;  ///< see FollowedOrders; empty: a restarted gateway may follow old signed orders
  std::string state_id;       ///< see Membership::Options
  std::string history_file;   ///< keeps changes of state across restarts (ChangeFile); empty: memory only
  std::chrono::milliseconds session_timeout{10000};
  RestartPolicy restart;
  std::optional<ProvisioningRules> provisioning;  ///< rules by which the gateway makes instances itself
  std::string provisioned_file;                   ///< see Provisioner::Options::file
  std::chrono::milliseconds retry_pause{1000};    ///< until the next attempt at what the registry did not permit
  const config::Clock* clock = nullptr;           ///< nullptr: the system's
  config::Metrics* metrics = nullptr;             ///< of the rules; nullptr: the process's
  /// Called once, on the gateway's thread, when another process has taken the gateway's place in the registry, which
  /// may happen after this one was cut off: its driver hosts have ended, and it does nothing any more. \param why for
  /// people
  std::function<void(const std::string& why)> on_replaced{};
};

/// Carries out the orders of one gateway in the registry (`/iot/gateways/<id>/orders`) with driver hosts, and reports
/// the state of the instances in their driver and channel records. While the registry is unreachable the gateway goes
/// on, and writes the changed records when the registry is back. A registry that comes back empty, or in an earlier
/// state, gets the gateway's records again, but its orders are followed only after somebody adopted them (OrderFeed).
/// Thread safe.
class Gateway final : public config::DaemonService {
 public:
  /// \throws config::Error for invalid options (a bad id, a broker without URLs).
  explicit Gateway(GatewayOptions options);
  /// Calls stop() with a limit of five seconds unless it was called.
  ~Gateway() override;

  /// Adopts running hosts and registers the gateway. Returns when the gateway is registered, or when the registry is
  /// unreachable; then the gateway keeps trying. \throws config::Error if another gateway with this id is alive, which
  /// is certain only after the session of a dead one would have expired; the adopted hosts have ended then. A stop that
  /// is asked for ends this wait: the gateway is not registered then, and stop() ends the adopted hosts.
  void start(const std::stop_token& stop) override;
  using config::DaemonService::start;
  /// Stops the instances (their records say `inactive`), ends their hosts and leaves the registry. Orders stay.
  void stop(std::chrono::milliseconds limit) override;

  /// Why no orders are followed, or why the registry does not show this gateway (another one has its id, its node was
  /// removed), in one line; empty: neither, or the registry is away.
  std::string trouble() const override;

  /// Shows in the gateway's record what its drivers cannot do now; empty: nothing is known. Returns at once.
  void show_trouble(const std::string& text);

  /// Other rules count from now on; without GatewayOptions::provisioning nothing happens. Returns at once.
  void set_rules(ProvisioningRules rules);

  const discovery::GatewayId& id() const;
  /// Whether the id was this gateway's at some time since start(): until then its orders may be another gateway's.
  bool has_joined() const;
  /// Whether only orders with a master's signature are followed, so that this gateway can give itself none.
  bool follows_signed_orders() const;
  /// The store of uploaded plugins; null: the gateway takes no uploads.
  processes::PluginStore* plugins() const;
  /// All plugins that this gateway has, for people and for checks of orders.
  std::vector<discovery::KnownPlugin> known_plugins() const;
  /// The highest epoch of all orders so far. An order that this gateway's Thrift service writes must have it.
  std::int64_t epoch() const;
  /// The current record of each instance.
  std::vector<discovery::DriverRecord> instances() const;
  /// The latest changes of state of an instance, or of all instances (undeployed ones included) if the id is empty; the
  /// oldest first.
  std::vector<StateChange> changes(const discovery::InstanceId& instance) const;
  /// Asks the instance's driver host, and waits for the answer. \return its `problem` says why there is none
  discovery::ChannelLook ask(const ChannelQuestion& question, std::chrono::milliseconds limit);
  using AwaitedRecord = OrderedInstances::AwaitedRecord;
  using Condition = OrderedInstances::Condition;
  /// See OrderedInstances::wait_for().
  AwaitedRecord wait_for(const discovery::InstanceId& instance, const Condition& condition,
                         std::chrono::milliseconds limit, std::int64_t order_version = -1) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
