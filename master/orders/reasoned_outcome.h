#pragma once

#include <chrono>
#include <optional>
#include <string>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// The outcome of an order for one instance, gateway or worker, with its reason.
struct ReasonedOutcome {
  OrderOutcome outcome = OrderOutcome::unknown;
  std::string reason;
};
/// The outcome that is known as soon as an order was written or could not be written. nullopt: it was written, and its
/// outcome must be waited for.
using EarlyOutcome = std::optional<ReasonedOutcome>;

/// The outcome for one that has reported nothing. \param limit how long it was waited for. \param stopped the wait
/// ended early because this master stops. \param last_state what its record said last; may be empty.
ReasonedOutcome without_report(const discovery::Registry& registry, std::chrono::milliseconds limit, bool stopped,
                               const std::string& last_state);

}  // namespace iotcloud::master
