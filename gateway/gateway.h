#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
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
#include <iotcloud/gateway/plugins/plugin_store.h>

namespace iotcloud::gateway {

struct GatewayOptions {
  std::string id;
  std::string host = "127.0.0.1";  ///< where others reach its Thrift service
  int port = 0;                    ///< of its Thrift service; 0: none
  bool tls = false;                ///< whether that speaks TLS
  std::vector<brokers::BrokerSetting> brokers;
  discovery::Registry* registry = nullptr;  ///< not null; outlives the gateway
  discovery::Paths paths;
  std::shared_ptr<HostLauncher> launcher;  ///< not null
  std::shared_ptr<PluginStore> plugins;    ///< that are sent; null: none can be
  std::string state_id;                    ///< see Membership::Options
  std::string history_file;                ///< where changes of state outlive the gateway; empty: they do not
  std::chrono::milliseconds session_timeout{10000};
  RestartPolicy restart;
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
};

/// Makes its orders in the registry (/iot/gateways/<id>/orders) come true with driver hosts, and writes what is into
/// the driver and channel records. Works on while the registry is away; what changed is written when it is back.
/// Thread safe.
class Gateway final : public config::Service {
 public:
  /// \throws config::Error for options that cannot be (a bad id, a broker without URLs).
  explicit Gateway(GatewayOptions options);
  /// Stops with a limit of five seconds unless stopped.
  ~Gateway() override;

  /// Takes over running hosts and registers. Returns when registered, or when the registry is away: then it keeps
  /// trying. \throws config::Error when another gateway of this id is alive (known after its session could have
  /// expired).
  void start() override;
  /// Stops the instances (their records say `inactive`), ends their hosts and leaves the registry. Orders stay.
  void stop(std::chrono::milliseconds limit) override;

  const std::string& id() const;
  /// Where plugins that are sent are kept; null: nowhere.
  PluginStore* plugins() const;
  /// The highest epoch of the orders seen: what an order given here must carry.
  std::int64_t epoch() const;
  /// Instances as they are.
  std::vector<discovery::DriverRecord> instances() const;
  /// The latest changes of state of an instance, or of all when the id is empty, of those that are gone too; the oldest
  /// first.
  std::vector<StateChange> changes(const std::string& instance) const;
  using Outcome = OrderedInstances::Outcome;
  using Condition = OrderedInstances::Condition;
  /// See OrderedInstances::wait_for().
  Outcome wait_for(const std::string& instance, const Condition& condition, std::chrono::milliseconds limit,
                   std::int64_t order_version = -1) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
