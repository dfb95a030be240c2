#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/master.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::master::test {

/// The longest that a test waits before it fails.
using tests::patience;

/// A registry that no other test sees.
std::string fresh_registry_url();
std::unique_ptr<discovery::Registry> open_registry(const std::string& url);

using tests::eventually;

/// Gives an order which somebody never answers, with a longer limit each time, until the limit was long enough for all
/// others: how long they take depends on how busy the machine is. \param give gives the order with that limit.
/// \return what became of the last one.
template <typename Give>
auto with_time_for_all_but(std::size_t silent, std::chrono::milliseconds& limit, const Give& give) {
  for (;; limit *= 2) {
    auto result = give(limit);
    const auto unknown = std::count_if(result.outcomes.begin(), result.outcomes.end(),
                                       [](const auto& each) { return each.outcome == OrderOutcome::unknown; });
    if (static_cast<std::size_t>(unknown) <= silent || limit > patience) return result;
  }
}

/// A gateway that follows orders as a real one does, and reports what the test says.
class FakeGateway {
 public:
  /// The gateway's report for an order; nullopt: none.
  using Report = std::pair<discovery::DriverState, std::string>;
  using Behaviour = std::function<std::optional<Report>(const discovery::OrderRecord&)>;
  /// Follows the order.
  static std::optional<Report> obey(const discovery::OrderRecord& order);
  static Behaviour fail(std::string reason);
  static Behaviour say_nothing();

  FakeGateway(const std::string& registry_url, std::string id, Behaviour behaviour = obey);
  /// Dies: its records stay.
  ~FakeGateway();

  const discovery::GatewayId& id() const { return id_; }
  void behave(Behaviour behaviour);
  /// Reports a state for an order that it has seen, whatever its behaviour says.
  void report(const std::string& instance, discovery::DriverState state, const std::string& reason = "",
              bool starts_again = false);
  std::vector<discovery::OrderRecord> orders() const;  ///< the current orders, sorted by instance
  int orders_seen() const;                             ///< number of orders and changes of orders that it has seen
  bool wait_for_orders(std::size_t count) const;

 private:
  void on_names(const std::vector<std::string>& names);
  void on_order(const std::string& instance, const std::optional<discovery::Node>& node);
  discovery::DriverRecord record(const discovery::OrderRecord& order, discovery::DriverState state,
                                 const std::string& reason, int made_anew) const;

  const discovery::GatewayId id_;
  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  Behaviour behaviour_;                                   ///< guarded by mutex_
  std::map<std::string, discovery::OrderRecord> orders_;  ///< guarded by mutex_
  std::map<std::string, int> made_anew_;  ///< guarded by mutex_: by instance: how often its properties changed
  int seen_ = 0;                          ///< guarded by mutex_
  std::map<std::string, discovery::GuardPtr> watches_;  ///< used by the registry's dispatcher
  discovery::GuardPtr alive_;
  discovery::GuardPtr names_;
};

/// A master with a session of its own at a registry. It leads, or is on standby while another one leads.
class TestMaster {
 public:
  explicit TestMaster(const std::string& registry_url, MasterOptions options = quick());
  static MasterOptions quick();
  /// Waits until this master leads.
  bool leads() const;
  Master* operator->() { return master_.get(); }
  Master& operator*() { return *master_; }
  discovery::Registry& registry() { return *registry_; }
  /// Ends the master, as if its process ended.
  void end();

 private:
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<Master> master_;
};

}  // namespace iotcloud::master::test
