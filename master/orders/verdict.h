#pragma once

#include <chrono>
#include <optional>
#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// The outcome of an order in one place: an instance, a gateway or a worker.
struct Verdict {
  OrderOutcome outcome = OrderOutcome::unknown;
  std::string reason;
};
/// The verdict that is known as soon as an order was written or could not be written. nullopt: it was written, and its
/// outcome must be waited for.
using MaybeVerdict = std::optional<Verdict>;

/// The verdict on a place that has reported nothing. \param limit how long it was waited for. \param stopped the wait
/// ended early because this master stops. \param last_state what its record said last; may be empty.
Verdict without_report(const discovery::Registry& registry, std::chrono::milliseconds limit, bool stopped,
                       const std::string& last_state);

}  // namespace iotcloud::master
