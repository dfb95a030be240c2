#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace iotcloud::master {

/// What became of an order for one instance on one gateway.
enum class Outcome {
  done,     ///< the gateway reported the wanted state
  failed,   ///< the gateway reported a failure, or the order could not be written
  pending,  ///< recorded; the gateway is lost and will do it when it comes back
  unknown,  ///< nothing was heard in time: it may still happen
};
std::string to_string(Outcome outcome);

struct InstanceOutcome {
  std::string gateway;
  std::string instance;
  Outcome outcome = Outcome::unknown;
  std::string reason;  ///< for people; empty when done and nothing is to be said
  friend bool operator==(const InstanceOutcome&, const InstanceOutcome&) = default;
};

/// What an order asks of an instance that is deployed.
enum class Change { undeploy, start, stop };
std::string to_string(Change change);

/// Why a master took no order at all: nothing was written.
enum class Refusal {
  none,
  not_leading,       ///< another master leads: OrderResult::leader
  unknown_gateway,   ///< the text lists the known ones
  unknown_instance,  ///< the text says which
  bad_request,       ///< a name that cannot be one, a count out of range
  registry_away,     ///< the registry did not answer
  unknown_topology,  ///< the text lists the known ones
};

/// The answer to an order: refused as a whole, or an outcome for each instance.
struct OrderResult {
  Refusal refusal = Refusal::none;
  std::string text;    ///< why it was refused, and how to mend it
  std::string leader;  ///< host:port of the master that leads, when `not_leading` and known
  std::vector<InstanceOutcome> outcomes;

  /// Not refused, and every outcome is `done`.
  bool all_done() const;
  /// One line for people: "2 of 3 done; lab2: failed: no such plugin (turtel.so)".
  std::string summary() const;
};

/// Time to wait for outcomes when the caller names none: MasterOptions::outcome_timeout.
using WaitLimit = std::optional<std::chrono::milliseconds>;

struct DeployRequest {
  std::vector<std::string> gateways;  ///< empty: all that are registered
  std::string plugin;    ///< file name ("turtle.so"), in the gateway's plugin folder unless `sha256` is given
  std::string sha256{};  ///< of a plugin that was sent to the gateways before
  std::string driver;    ///< name of the driver; empty: the plugin's own
  std::map<std::string, std::string> properties;
  std::map<std::string, std::string> metadata;
  int count = 1;  ///< instances on each gateway, 1 to max_count
  WaitLimit wait;
  /// Of the deployment. With the gateway and a number from 1 to `count` it names an instance: what is deployed already
  /// is not deployed again, its outcome is `failed`. Empty: the instances have no names.
  std::string name;
  std::vector<int> indexes;  ///< with a name: these numbers, not 1 to `count`
  std::string manager;       ///< the manifest that the instances belong to; empty: a person deploys
  bool active = true;        ///< false: they are deployed, and wait to be started
  static constexpr int max_count = 10'000;
};

/// Changes what instances were deployed with. They keep their ids; those whose properties change are made anew.
struct DeploymentChange {
  std::vector<std::string> instances;                            ///< ids in full
  std::optional<std::map<std::string, std::string>> properties;  ///< all of them; nullopt: as they are
  std::optional<std::string> manager;  ///< the manifest that they belong to from now on; nullopt: as it is
  WaitLimit wait;
};

/// Gateways that are to drain, or no longer.
struct GatewaySelection {
  std::vector<std::string> gateways;  ///< at least one
  WaitLimit wait;
};

/// What others are to see of instances from now on: values by key; an empty value takes the key away.
using MetadataChanges = std::map<std::string, std::string>;

/// Instances that an order to undeploy, start, stop or describe them is for.
struct InstanceSelection {
  std::vector<std::string> instances;  ///< ids in full
  std::vector<std::string> gateways;   ///< when not empty, the instances must be on one of these
  WaitLimit wait;
};

/// Another version of their plugin for instances that are deployed; they keep id, properties and metadata.
struct UpdateRequest {
  InstanceSelection selection;  ///< `wait`: how long each step may take, and as long again to go back
  std::string plugin;           ///< as in DeployRequest
  std::string sha256{};         ///< as in DeployRequest
  int at_once = 0;              ///< instances in one step, up to max_at_once; 0: all of one gateway
  /// How long those of a step must stay up before the next one; at most ten minutes. 0: a moment is enough.
  std::chrono::milliseconds settle{0};
  static constexpr int max_at_once = 10'000;
};

}  // namespace iotcloud::master
