#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <iosfwd>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/plan.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master::cli {

class MasterClient;

/// The outcome of one step of a plan.
struct FleetStepOutcome {
  std::string outcome;  ///< "done", "failed", "pending", "unknown"
  std::string reason;   ///< for people; empty when there is nothing to say
};

struct ApplyOptions {
  /// Makes another connection to the masters; called on the caller's thread.
  std::function<std::unique_ptr<MasterClient>()> connect;
  WaitLimit wait;  ///< for the outcome of one order
  /// How long the updated instances of a gateway must stay up before the next gateway is updated.
  std::chrono::milliseconds settle{0};
  /// Called whenever some steps were done: on any thread, but one call at a time.
  std::function<void(std::size_t done, std::size_t all)> progress;
  std::function<void()> on_orders;   ///< called once, when the plugins are sent and the first order comes next
  std::ostream* terminal = nullptr;  ///< shows the progress of sending a plugin; nullptr: nobody sees it
};

/// Does the steps of a plan. First it sends plugins that are files of this machine to the gateways that need them; when
/// a gateway does not take a plugin, the steps there that need it fail, and what runs there stays. Then it does the
/// steps of each gateway one after the other, and several gateways in parallel, so that a slow gateway delays no other.
/// Only updates of plugins and properties go gateway after gateway, as one order for each deployment: when an instance
/// does not come up with what is new, all instances of its deployment go back, and nothing more is done to that
/// deployment. Apart from that a failed step does not keep the others from being done; once a gateway has not answered
/// in time, its remaining orders are given without waiting for their outcomes. \return the outcomes in the order of the
/// steps. They also say what a master refused, or that no master answered: this function does not throw for either.
std::vector<FleetStepOutcome> apply(const Manifest& manifest, const FleetPlan& plan, const ApplyOptions& options);

}  // namespace iotcloud::master::cli
