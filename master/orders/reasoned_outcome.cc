#include <fmt/format.h>

#include <iotcloud/master/orders/reasoned_outcome.h>

namespace iotcloud::master {

ReasonedOutcome without_report(const discovery::Registry& registry, std::chrono::milliseconds limit, bool stopped,
                               const std::string& last_state) {
  if (stopped) return {OrderOutcome::unknown, "this master is stopping; the order stands"};
  std::string text =
      registry.session() == discovery::SessionState::connected
          ? fmt::format("not known after {} s, it may still happen", static_cast<double>(limit.count()) / 1000)
          : "the registry is away, so nothing can be heard; the order stands";
  if (!last_state.empty()) text += "; " + last_state;
  return {OrderOutcome::unknown, text};
}

}  // namespace iotcloud::master
