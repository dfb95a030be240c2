#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <iosfwd>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/plan.h>

namespace iotcloud::master::cli {

class MasterClient;

/// What became of one step of a plan.
struct StepOutcome {
  std::string outcome;  ///< "done", "failed", "pending", "unknown"
  std::string reason;   ///< for people; empty when there is nothing to say
};

struct ApplyOptions {
  /// Makes another connection to the masters; called on the caller's thread.
  std::function<std::unique_ptr<MasterClient>()> connect;
  std::int64_t wait_ms = 0;    ///< for the outcome of one order; 0: as long as the master thinks fit
  std::int64_t settle_ms = 0;  ///< how long the updated instances of a gateway must stay up before the next gateway's
  /// Called whenever some steps were done, on any thread, one at a time.
  std::function<void(std::size_t done, std::size_t all)> progress;
  std::ostream* terminal = nullptr;  ///< shows how far a plugin is sent; nullptr: that is not shown
};

/// Does the steps of a plan. Plugins that are files of this machine are sent first, to the gateways that need them;
/// what a gateway does not take fails, and leaves there what runs. Then those of one gateway one after the other,
/// gateways beside each other, so that a slow one delays no other. Only updates go gateway after gateway, as one order
/// for each deployment: when an instance does not come up with the other plugin all of its deployment go back, and
/// nothing more is done to that deployment. Otherwise a step that fails does not keep the others from being done; once
/// a gateway has not answered in time the rest of its orders is given without waiting for what comes of it. Does not
/// throw for what a master answers, or when none does: that is in the outcomes, which stand in the order of the steps.
std::vector<StepOutcome> apply(const Manifest& manifest, const Plan& plan, const ApplyOptions& options);

}  // namespace iotcloud::master::cli
