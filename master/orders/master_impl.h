#pragma once

#include <condition_variable>
#include <cstddef>
#include <functional>
#include <future>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <shared_mutex>
#include <stop_token>
#include <string>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/master/listing/driver_view.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/orders/direct_gateways.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/orders/outcome_watch.h>

/// The inside of Master, shared by the sources that make it.
namespace iotcloud::master {

/// ZooKeeper refuses nodes above 1 MiB; an order near that is a mistake.
inline constexpr std::size_t largest_order = std::size_t{512} * 1024;

inline constexpr const char* lost_lead_text = "this master has just lost its lead; the order was not recorded";
inline constexpr const char* lost_text = "gateway is lost; it will follow the order when it comes back";
inline constexpr const char* lost_and_not_recorded_text = "gateway is lost; the order was not recorded";

const discovery::GatewayStatus* find(const std::vector<discovery::GatewayStatus>& gateways, const std::string& id);
OrderResult refuse(Refusal refusal, std::string text);
/// The refusal of a gateway that is not registered, naming those that are.
OrderResult refuse_gateway(const std::string& id, const std::vector<discovery::GatewayStatus>& known);
/// The refusal of a plugin's name or hash that cannot be.
std::optional<OrderResult> refuse_plugin(const std::string& plugin, const std::string& sha256);
void set_verdict(InstanceOutcome& outcome, const std::optional<OutcomeWatch::Verdict>& verdict);

struct Master::Impl {
  using MaybeVerdict = std::optional<OutcomeWatch::Verdict>;  ///< nullopt: written, the outcome is yet to come
  using DirectCalls = std::vector<std::future<InstanceOutcome>>;

  Impl(discovery::Registry& registry_of_all, MasterOptions given);

  /// Counts an order as under way while it lives.
  class UnderWay {
   public:
    explicit UnderWay(Impl& impl) : impl_(impl) {
      std::lock_guard lock(impl_.mutex);
      ++impl_.under_way;
    }
    ~UnderWay() {
      std::lock_guard lock(impl_.mutex);
      if (--impl_.under_way == 0) impl_.idle.notify_all();
    }
    UnderWay(const UnderWay&) = delete;
    UnderWay& operator=(const UnderWay&) = delete;

   private:
    Impl& impl_;
  };

  std::string leader() const { return election.leading() ? options.address : election.leader_data(); }

  std::optional<OrderResult> refuse_unless_leading() const;
  /// The refusal of an order that the registry did not take.
  OrderResult refuse_for(const discovery::RegistryError& error) const;

  /// How long to wait when the caller asked for `wait`.
  std::chrono::milliseconds limit(const WaitLimit& wait) const;

  /// Runs an order's body with the checks and errors that all orders share.
  template <typename Body>
  OrderResult guarded(Body&& body) {
    UnderWay guard(*this);
    if (auto refusal = refuse_unless_leading()) return *refusal;
    try {
      return body();
    } catch (const discovery::RegistryError& e) {
      return refuse_for(e);
    } catch (const config::Error& e) {
      return refuse(Refusal::bad_request, e.what());
    }
  }

  /// Writes to the registry, with the fence of the lead that it is given; what that says about the order, when it is
  /// not simply written.
  template <typename Write>
  MaybeVerdict written(Write&& write) {
    const auto lead = election.lead();
    if (!lead) return OutcomeWatch::Verdict{Outcome::failed, lost_lead_text};
    try {
      return write(*lead);
    } catch (const discovery::RegistryError& e) {
      if (e.code() == discovery::RegistryErrorCode::fenced)
        return OutcomeWatch::Verdict{Outcome::failed, lost_lead_text};
      if (e.code() == discovery::RegistryErrorCode::away)
        return OutcomeWatch::Verdict{Outcome::unknown,
                                     fmt::format("whether the order was recorded is not known: {}", e.what())};
      return OutcomeWatch::Verdict{Outcome::failed, e.what()};
    }
  }

  // order_deploy.cc
  std::optional<OrderResult> refuse_deployment(const DeployRequest& request) const;
  discovery::OrderRecord order_for(const DeployRequest& request) const;
  OrderResult deploy(const DeployRequest& request);
  /// Where a request is for. \return why that cannot be; nullopt: they are in `targets`.
  std::optional<OrderResult> find_targets(const DeployRequest& request,
                                          const std::vector<discovery::GatewayStatus>& known,
                                          std::vector<const discovery::GatewayStatus*>& targets) const;
  /// Orders all instances of a request on one gateway.
  void order_instances(const DeployRequest& request, const discovery::GatewayStatus& gateway, OrderResult& result,
                       OutcomeWatch& watch);
  MaybeVerdict order_deployment(const discovery::GatewayStatus& gateway, discovery::OrderRecord order,
                                OutcomeWatch& watch);

  // order_change.cc
  /// Where an instance stands in the registry.
  struct Located {
    std::string instance;
    std::string gateway;
    std::string driver;                     ///< empty: no record yet
    std::optional<discovery::Node> record;  ///< nullopt: no record yet
  };
  /// Those of the instances that are anywhere, in a few rounds whatever there is.
  std::map<std::string, Located> locate(const std::set<std::string>& instances,
                                        const std::vector<discovery::GatewayStatus>& known);

  /// Finds all that are selected before the first order is written: a mistyped id changes nothing.
  /// \return why that cannot be; nullopt: they are in `instances`.
  std::optional<OrderResult> find_selected(const InstanceSelection& selection,
                                           const std::vector<discovery::GatewayStatus>& known,
                                           std::vector<Located>& instances);

  OrderResult change(const InstanceSelection& selection, Change change);
  MaybeVerdict order_change(const Located& where, const discovery::GatewayStatus& gateway, Change change,
                            OutcomeWatch& watch);
  MaybeVerdict clear_away(const Located& where, Change change);
  MaybeVerdict remove_order(const Located& where, const discovery::Lead& lead);
  /// Changes an order that stands in the registry; written again when another master was faster.
  MaybeVerdict rewrite_order(const Located& where, const discovery::Lead& lead,
                             const std::function<void(discovery::OrderRecord&)>& alter);

  // order_metadata.cc
  OrderResult update_metadata(const InstanceSelection& selection, const MetadataChanges& changes);
  MaybeVerdict order_metadata(const Located& where, const discovery::GatewayStatus* gateway,
                              const MetadataChanges& changes, OutcomeWatch& watch);

  // order_deployment_change.cc
  OrderResult change_deployment(const DeploymentChange& change);
  MaybeVerdict order_deployment_change(const Located& where, const discovery::GatewayStatus* gateway,
                                       const DeploymentChange& change, OutcomeWatch& watch);

  // order_drain.cc
  OrderResult drain(const GatewaySelection& selection, bool undo);
  void mark_draining(const std::string& gateway, bool undo, const discovery::Lead& lead);
  MaybeVerdict order_drain(const Located& where, const discovery::GatewayStatus& gateway, bool undo,
                           OutcomeWatch& watch);

  // order_update.cc
  class RollingUpdate;

  // topology_orders.cc
  TopologyResult order(const TopologyRequest& request);
  std::optional<TopologyResult> refuse_unknown_topology(const std::string& name);
  discovery::TopologyOrder changed_order(const std::optional<discovery::Node>& node, const TopologyRequest& request,
                                         const std::vector<discovery::WorkerRecord>& workers,
                                         const discovery::Lead& lead, std::chrono::milliseconds wait) const;
  discovery::TopologyOrder write_order(const TopologyRequest& request,
                                       const std::vector<discovery::WorkerRecord>& workers, const discovery::Lead& lead,
                                       std::chrono::milliseconds wait);
  void clear_killed(const std::string& topology, const discovery::Lead& lead, TopologyResult& result);

  // master.cc
  bool is_direct(const std::string& gateway) const { return options.direct && options.direct->has(gateway); }
  /// Waits for all outcomes, then logs and counts them.
  void settle(OrderResult& result, OutcomeWatch& watch, DirectCalls& calls, const WaitLimit& wait,
              const std::string& order);
  /// Logs and counts what became of an order.
  void tell(const OrderResult& result, const std::string& order);

  discovery::Registry& registry;
  const MasterOptions options;
  DriverView view{registry, options.paths};
  std::stop_source closing;
  /// Shared while what makes instances run is written, exclusive while gateways are marked as draining: one of them
  /// sees the other.
  std::shared_mutex placing;
  std::mutex mutex;
  std::condition_variable idle;
  int under_way = 0;               ///< guarded by mutex
  std::set<std::string> updating;  ///< guarded by mutex: instances of which an update is under way
  discovery::Election election;    ///< last: its callbacks use the others
};

}  // namespace iotcloud::master
