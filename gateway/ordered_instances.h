#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/change_log.h>
#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/gateway/registration/record_writer.h>

namespace iotcloud::gateway {

/// The instances that a gateway was ordered to run: makes each order come true in a fleet of driver hosts, and writes
/// what is into the registry's records. Used on one event loop unless said otherwise.
class OrderedInstances {
 public:
  struct Options {
    std::string gateway;            ///< id
    discovery::Registry* registry;  ///< not null
    discovery::Paths paths;
    HostLauncher* launcher;  ///< not null
    std::vector<brokers::BrokerSetting> brokers;
    RestartPolicy restart;
    const config::Clock* clock;  ///< not null
    std::string history_file;    ///< see ChangeLog
  };
  OrderedInstances(Options options, EventLoop& loop);

  /// Takes over what an earlier life of the gateway left running.
  void adopt();
  /// What stands in the registry, once it is known: what runs without an order is removed, what is said of it too.
  void ordered_at_first(const std::set<std::string>& names);
  /// Follows a new or changed order. \param version of its node
  void follow(const discovery::OrderRecord& order, std::int64_t version);
  /// The order was taken back: the instance and its record go.
  void forget(const std::string& instance);
  /// Writes records that could not be written.
  void write_records() { records_.flush(); }
  /// The SHA-256 of the plugins that orders name, also to go back to; nullopt while not all orders are known.
  std::optional<std::set<std::string>> plugins_named() const;
  /// Ends all instances, whose records say `inactive`; orders stay. `done` is called once when that is so.
  void stop(std::chrono::milliseconds limit, std::function<void()> done);

  // Thread safe.
  std::vector<discovery::DriverRecord> all() const;
  const ChangeLog& changes() const { return changes_; }
  /// What came of an order, see wait_for().
  struct Outcome {
    bool known = false;                             ///< false: the limit passed first
    std::optional<discovery::DriverRecord> record;  ///< the record that met the condition; nullopt: there is none
  };
  using Condition = std::function<bool(const std::optional<discovery::DriverRecord>&)>;
  /// Waits until the condition holds for the instance's record (nullopt: there is none), and the order's version in the
  /// registry that the record follows is at least `order_version`.
  Outcome wait_for(const std::string& instance, const Condition& condition, std::chrono::milliseconds limit,
                   std::int64_t order_version) const;

 private:
  /// One ordered instance. `in_fleet`: a host knows it, so its end will be reported.
  struct Entry {
    discovery::OrderRecord order;
    std::int64_t order_version = -1;
    InstanceStatus status;
    bool in_fleet = false;
    bool removing = false;
    std::optional<discovery::OrderRecord> next;  ///< to be made when the present one is gone
  };
  /// What wait_for() sees of an instance.
  struct Told {
    discovery::DriverRecord record;
    std::int64_t order_version = -1;
  };

  void create(const discovery::OrderRecord& order, std::int64_t version);
  void replace(Entry& entry, const discovery::OrderRecord& order);
  void refuse(Entry& entry, const std::string& reason);
  void heard(const InstanceStatus& status);
  discovery::DriverRecord record_for(const Entry& entry) const;
  void publish_record(const Entry& entry);
  void drop_record(const std::string& driver, const std::string& instance);
  void remove_stale_records(const std::set<std::string>& ordered);

  const Options options_;
  RecordWriter records_;
  std::map<std::string, Entry> entries_;
  std::optional<std::set<std::string>> unread_;  ///< of the orders that stood at the start; nullopt: not known yet
  bool stopping_ = false;

  static constexpr std::size_t most_changes = 10'000;
  ChangeLog changes_;

  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::map<std::string, Told> told_;  ///< guarded by mutex_

  HostFleet fleet_;  ///< dies first: its links' last events are posted to the loop
};

}  // namespace iotcloud::gateway
