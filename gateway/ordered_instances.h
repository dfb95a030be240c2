#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/change_log.h>
#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/gateway/record_writer.h>

namespace iotcloud::gateway {

/// The instances that a gateway was ordered to run: carries out each order in a fleet of driver hosts, and writes the
/// instances' state into the registry's records. Used on one event loop unless said otherwise.
class OrderedInstances {
 public:
  struct Options {
    discovery::GatewayId gateway;
    discovery::Registry* registry;  ///< not null
    discovery::Paths paths;
    HostLauncher* launcher;  ///< not null
    std::vector<brokers::BrokerSetting> brokers;
    RestartPolicy restart;
    const config::Clock* clock;                        ///< not null
    std::string history_file;                          ///< see ChangeLog
    std::chrono::milliseconds session_timeout{10000};  ///< the shortest lease that an order may name
  };
  OrderedInstances(Options options, EventLoop& loop);

  /// Adopts the hosts and instances that an earlier run of the gateway left running.
  void adopt();
  /// Called once, when the names of all orders in the registry are known: removes instances that run without an order,
  /// and their records.
  void ordered_at_first(const std::set<discovery::InstanceId>& names);
  /// Follows a new or changed order. \param version the version of the order's node in the registry
  void follow(const discovery::OrderRecord& order, std::int64_t version);
  /// Runs an instance that this gateway's own rules make (Provisioner), until forget(). \param again start it again if
  /// it failed
  void provision(const discovery::OrderRecord& order, bool again);
  /// The adopted instances that rules made, and of which no order in the registry is to be read yet.
  std::set<discovery::InstanceId> left_by_rules() const;
  /// See HostFleet::on_found().
  void on_found(HostFleet::OnFound told) { fleet_.on_found(std::move(told)); }
  /// The order was removed: removes the instance and its record.
  void forget(const discovery::InstanceId& instance);
  /// The registry last confirmed the gateway's place at that time; instances with a lease run on it.
  void renew(config::Clock::Instant confirmed) { fleet_.renew(confirmed); }
  /// See HostFleet::ask().
  void ask(const ChannelQuestion& question, HostFleet::OnTold done) { fleet_.ask(question, std::move(done)); }
  /// Whether an instance has a lease.
  bool leased() const;
  /// Writes no record until resume_records(): the connection is lost, and the next one may lead to another state of the
  /// registry.
  void pause_records() { records_.pause(); }
  /// Writes the records that could not be written, and brings the changes of state to the disk. To be called after a
  /// reconnection, and periodically.
  void resume_records() {
    records_.resume();
    changes_.sync();
  }
  /// Finds the records that the registry lost; resume_records() puts them back. \throws discovery::RegistryError.
  void restore_records() { records_.restore(); }
  /// Puts the records of adopted instances whose orders are not followed yet.
  void publish_adopted();
  /// The ordered and the adopted instances, without those that are being removed for good and those of rules.
  std::set<discovery::InstanceId> present() const;
  /// Those of these instances of which the registry once had a record by this gateway, and has none now.
  /// \throws discovery::RegistryError.
  std::set<discovery::InstanceId> without_record(const std::set<discovery::InstanceId>& instances) const;
  /// The SHA-256 of all plugins that orders name, including those named for a rollback; nullopt while not all orders
  /// are known.
  std::optional<std::set<std::string>> plugins_named() const;
  /// Ends all instances and sets their records to `inactive`; the orders stay. Calls `done` once, when that is
  /// finished.
  void stop(std::chrono::milliseconds limit, std::function<void()> done);
  /// Like stop(), and writes nothing into the registry any more: the place there is another gateway's.
  void abandon(std::chrono::milliseconds limit, std::function<void()> done);

  // These are thread safe.
  std::vector<discovery::DriverRecord> all() const;
  const ChangeLog& changes() const { return changes_; }
  /// The outcome of an order, see wait_for().
  struct AwaitedRecord {
    bool known = false;  ///< false: the limit passed before the condition held
    /// The record for which the condition held; nullopt: it held for a missing record.
    std::optional<discovery::DriverRecord> record;
  };
  using Condition = std::function<bool(const std::optional<discovery::DriverRecord>&)>;
  /// Waits until the condition holds for the instance's record (nullopt if the instance has none) and the record
  /// reflects version `order_version` of the order, or a later one.
  AwaitedRecord wait_for(const discovery::InstanceId& instance, const Condition& condition,
                         std::chrono::milliseconds limit, std::int64_t order_version) const;

 private:
  /// One ordered instance. `in_fleet`: a host knows the instance and will report its end. `adopted`: an earlier run of
  /// the gateway left it running, and wrote its record.
  struct Entry {
    discovery::OrderRecord order;
    std::int64_t order_version = -1;
    InstanceStatus status;
    bool in_fleet = false;
    bool adopted = false;
    bool removing = false;
    std::optional<discovery::OrderRecord> next;  ///< the order to carry out when the current instance has ended
  };
  /// The part of an instance that other threads see: its record, the version of the order that the record reflects, and
  /// whether the record was given to the writer. all() shows it before that, wait_for() after it.
  struct Told {
    discovery::DriverRecord record;
    std::int64_t order_version = -1;
    bool given_to_writer = false;
  };

  void create(const discovery::OrderRecord& order, std::int64_t version);
  void bring_to(Entry& entry, const discovery::OrderRecord& order, bool again);
  void replace(Entry& entry, const discovery::OrderRecord& order);
  void refuse(Entry& entry, const std::string& reason);
  void heard(const InstanceStatus& status);
  discovery::DriverRecord record_for(const Entry& entry) const;
  void publish_record(const Entry& entry);
  void drop_record(const discovery::DriverName& driver, const discovery::InstanceId& instance);
  void remove_stale_records(const std::set<discovery::InstanceId>& ordered);

  const Options options_;
  RecordWriter records_;
  std::map<discovery::InstanceId, Entry> entries_;
  std::optional<std::set<discovery::InstanceId>>
      /// Instances whose orders existed at the start and are not read yet; nullopt: the list is not known yet.
      unread_;
  bool stopping_ = false;

  static constexpr std::size_t most_changes = 10'000;
  ChangeLog changes_;

  mutable config::Mutex mutex_;
  mutable config::ConditionVariable changed_;
  std::map<discovery::InstanceId, Told> told_ IOTCLOUD_GUARDED_BY(mutex_);  ///< written only on the loop

  HostFleet fleet_;  ///< destroyed first, because its links post their last events to the loop
};

}  // namespace iotcloud::gateway
