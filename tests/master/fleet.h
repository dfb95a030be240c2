#pragma once

#include <chrono>
#include <condition_variable>
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

/// What a test waits for at most before it fails.
inline constexpr std::chrono::seconds patience{20};

/// A registry that no other test sees.
std::string fresh_registry_url();
std::unique_ptr<discovery::Registry> open_registry(const std::string& url);

using tests::eventually;

/// A gateway that follows orders as a real one does, and reports what the test tells it to.
class FakeGateway {
 public:
  /// What it reports for an order; nullopt: it says nothing.
  using Report = std::pair<discovery::DriverState, std::string>;
  using Behaviour = std::function<std::optional<Report>(const discovery::OrderRecord&)>;
  /// Does as it is told.
  static std::optional<Report> obey(const discovery::OrderRecord& order);
  static Behaviour fail(std::string reason);
  static Behaviour say_nothing();

  FakeGateway(const std::string& registry_url, std::string id, Behaviour behaviour = obey);
  /// It dies: its records stay.
  ~FakeGateway();

  const std::string& id() const { return id_; }
  void behave(Behaviour behaviour);
  /// Reports for an order that it has seen, whatever its behaviour says.
  void report(const std::string& instance, discovery::DriverState state, const std::string& reason = "");
  std::vector<discovery::OrderRecord> orders() const;  ///< as they stand, by instance
  int orders_seen() const;                             ///< each change counts
  bool wait_for_orders(std::size_t count) const;

 private:
  void on_names(const std::vector<std::string>& names);
  void on_order(const std::string& instance, const std::optional<discovery::Node>& node);
  discovery::DriverRecord record(const discovery::OrderRecord& order, discovery::DriverState state,
                                 const std::string& reason, int made_anew) const;

  const std::string id_;
  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  Behaviour behaviour_;                                   ///< guarded by mutex_
  std::map<std::string, discovery::OrderRecord> orders_;  ///< guarded by mutex_
  std::map<std::string, int> made_anew_;                  ///< guarded by mutex_: how often its properties changed
  int seen_ = 0;                                          ///< guarded by mutex_
  std::map<std::string, discovery::GuardPtr> watches_;    ///< of the registry's dispatcher
  discovery::GuardPtr alive_;
  discovery::GuardPtr names_;
};

/// A master of its own session on a registry, leading (or standing by behind the one that leads).
class TestMaster {
 public:
  explicit TestMaster(const std::string& registry_url, MasterOptions options = quick());
  static MasterOptions quick();
  /// Waits until it leads.
  bool leads() const;
  Master* operator->() { return master_.get(); }
  Master& operator*() { return *master_; }
  discovery::Registry& registry() { return *registry_; }
  /// The master goes away, as a process that ends.
  void end();

 private:
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<Master> master_;
};

}  // namespace iotcloud::master::test
