#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>

namespace iotcloud::master {

/// The outcome of an order for one instance on one gateway. Numbers are those of TOutcome.
enum class OrderOutcome {
  done,     ///< the gateway reported the wanted state
  failed,   ///< the gateway reported a failure, or the order could not be written
  pending,  ///< recorded; the gateway is lost and will do it when it comes back
  unknown,  ///< no report came in time: the change may still happen
};
std::string to_string(OrderOutcome outcome);
inline std::string json_value(OrderOutcome outcome) {
  return to_string(outcome);
}

/// The outcome of an order for one instance.
struct InstanceOutcome {
  discovery::GatewayId gateway;
  discovery::InstanceId instance;
  OrderOutcome outcome = OrderOutcome::unknown;
  std::string reason;  ///< why, for people; may be empty for `done`
  static constexpr const char* what = "an outcome";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, usual), IOTCLOUD_FIELD(gateway, usual),
                                            IOTCLOUD_FIELD(outcome, usual), IOTCLOUD_FIELD(reason, usual)};
  friend bool operator==(const InstanceOutcome&, const InstanceOutcome&) = default;
};

/// The kinds of orders to an instance that is deployed.
enum class InstanceAction { undeploy, start, stop };
std::string to_string(InstanceAction action);

/// Why a master took no order at all: nothing was written. Numbers are those of TRefusal.
enum class OrderRefusal {
  none,
  not_leading,        ///< another master leads: OrderResult::leader
  unknown_gateway,    ///< the text lists the known ones
  unknown_instance,   ///< the text says which
  bad_request,        ///< an invalid name, a count out of range
  registry_away,      ///< the registry did not answer
  not_authenticated,  ///< the service requires a token
  unknown_topology,   ///< the text lists the known ones
  not_allowed,        ///< the role of the token may not do this
};

/// The answer to an order: refused as a whole, or an outcome for each instance.
struct OrderResult {
  OrderRefusal refusal = OrderRefusal::none;
  std::string text;    ///< why the order was refused, and how to mend it
  std::string leader;  ///< host:port of the master that leads, when `not_leading` and known
  std::vector<InstanceOutcome> outcomes;
  static constexpr const char* what = "an answer to an order";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(refusal, usual), IOTCLOUD_FIELD(leader, rare), IOTCLOUD_FIELD(outcomes, usual)};

  /// Not refused, and every outcome is `done`.
  bool all_done() const;
  /// One line for people: "2 of 3 done; lab2: failed: no such plugin (turtel.so)".
  std::string summary() const;
};

/// How long to wait for outcomes; nullopt: for MasterOptions::outcome_timeout.
using WaitLimit = std::optional<std::chrono::milliseconds>;

/// The part of a deployment in which its instances differ.
struct InstanceProperties {
  int index = 0;  ///< the instance's number, from 1 on
  /// In addition to the deployment's properties, and in place of those of the same name.
  std::map<std::string, std::string> properties;
  static constexpr const char* what = "an instance's own properties";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(index, required), IOTCLOUD_FIELD(properties, required)};
};

/// Instances to deploy. If the deployment has a name, the name, a gateway and a number from 1 to `count` identify each
/// instance: one that exists already is not deployed again, and its outcome is `failed`.
struct DeployRequest : discovery::Deployment {
  std::vector<discovery::GatewayId> gateways;  ///< empty: all that are registered
  int count = 1;                               ///< instances on each gateway, 1 to max_count
  std::vector<int> indexes;  ///< for deployments with a name: use these numbers instead of 1 to `count`
  WaitLimit wait;
  std::vector<InstanceProperties> own{};  ///< what some instances, on each gateway, have of their own
  static constexpr int max_count = 10'000;
  static constexpr const char* what = "a deployment";
  static constexpr auto fields = std::tuple_cat(
      discovery::Deployment::fields,
      std::tuple{IOTCLOUD_FIELD(gateways, usual), IOTCLOUD_FIELD(count, usual), IOTCLOUD_FIELD(indexes, rare),
                 IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs), IOTCLOUD_FIELD(own, rare)});
};

/// Changes what instances were deployed with. The instances keep their ids; those whose properties change are created
/// anew.
struct DeploymentChange {
  std::vector<discovery::InstanceId> instances;                  ///< ids in full
  std::optional<std::map<std::string, std::string>> properties;  ///< replace all properties; nullopt: they stay
  std::optional<std::string> manager;  ///< the manifest that owns them from now on; nullopt: it stays
  WaitLimit wait;
  static constexpr const char* what = "a change of deployments";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(instances, required), IOTCLOUD_FIELD(properties, rare), IOTCLOUD_FIELD(manager, rare),
                 IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs)};
};

/// The gateways of an order to drain or undrain.
struct GatewaySelection {
  std::vector<discovery::GatewayId> gateways;  ///< at least one
  WaitLimit wait;
  static constexpr const char* what = "a choice of gateways";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(gateways, required), IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs)};
};

/// Changes of instances' metadata: values by key; an empty value removes the key.
using MetadataChanges = std::map<std::string, std::string>;

/// The instances that an order is for.
struct InstanceSelection {
  std::vector<discovery::InstanceId> instances;  ///< ids in full
  std::vector<discovery::GatewayId> gateways;    ///< when not empty, the instances must be on one of these
  WaitLimit wait;
  static constexpr const char* what = "a choice of instances";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instances, required), IOTCLOUD_FIELD(gateways, usual),
                                            IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs)};
};

/// An order to change the metadata of some instances.
struct MetadataOrder : InstanceSelection {
  MetadataChanges changes;
  static constexpr const char* what = "a change of metadata";
  static constexpr auto fields =
      std::tuple_cat(InstanceSelection::fields, std::tuple{IOTCLOUD_FIELD(changes, required)});
};

/// All properties that an instance is to have.
struct NewProperties {
  discovery::InstanceId instance;
  std::map<std::string, std::string> properties;
  static constexpr const char* what = "an instance's new properties";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(properties, usual)};
};

/// An order to give deployed instances another version of their plugin, other properties, or both, step by step; they
/// keep id and metadata. If one does not come up, all that were changed go back.
struct UpdateRequest {
  InstanceSelection selection;  ///< `wait`: how long each step may take, and as long again to go back
  std::string plugin;           ///< as in discovery::Deployment; empty: each instance keeps its own
  std::string sha256{};         ///< as in discovery::Deployment
  int at_once = 0;              ///< instances in one step, up to max_at_once; 0: all of one gateway
  /// How long the instances of a step must stay up before the next step begins; at most ten minutes. 0: not at all.
  std::chrono::milliseconds settle{0};
  std::vector<NewProperties> properties{};  ///< of instances of the selection; those not named keep theirs
  static constexpr int max_at_once = 10'000;
  static constexpr const char* what = "an update";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(selection, required),
                                            IOTCLOUD_FIELD(plugin, required),
                                            IOTCLOUD_FIELD(sha256, rare),
                                            IOTCLOUD_FIELD_AS(at_once, rare, "at_once", atOnce),
                                            IOTCLOUD_FIELD_AS(settle, rare, "settle_ms", settleMs),
                                            IOTCLOUD_FIELD(properties, rare)};
};

/// An order in words, for the audit log, without secrets.
std::string words(const std::vector<discovery::GatewayId>& gateways, const char* when_empty);
std::string words(const std::vector<discovery::InstanceId>& instances, const char* when_empty);
std::string words(const DeployRequest& request);
std::string words(const DeploymentChange& change);
std::string words(const GatewaySelection& selection);
std::string words(const InstanceSelection& selection);
std::string words(const UpdateRequest& update);

}  // namespace iotcloud::master
