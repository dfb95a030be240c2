#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

std::string to_string(OrderOutcome outcome) {
  switch (outcome) {
    case OrderOutcome::done:
      return "done";
    case OrderOutcome::failed:
      return "failed";
    case OrderOutcome::pending:
      return "pending";
    case OrderOutcome::unknown:
      return "unknown";
  }
  return "unknown";
}

std::string to_string(InstanceAction action) {
  switch (action) {
    case InstanceAction::undeploy:
      return "undeploy";
    case InstanceAction::start:
      return "start";
    case InstanceAction::stop:
      return "stop";
  }
  return "";
}

bool OrderResult::all_done() const {
  return refusal == OrderRefusal::none &&
         std::all_of(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == OrderOutcome::done; });
}

std::string OrderResult::summary() const {
  if (refusal != OrderRefusal::none) return text;
  const auto done =
      std::count_if(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == OrderOutcome::done; });
  auto line = fmt::format("{} of {} done", done, outcomes.size());
  // The text is for people, who need the first failures and not ten thousand of them.
  constexpr int shown_at_most = 5;
  int shown = 0;
  for (const auto& o : outcomes) {
    if (o.outcome == OrderOutcome::done) continue;
    if (shown++ == shown_at_most) return line + "; ...";
    line += fmt::format("; {} on {}: {}: {}", o.instance, o.gateway, to_string(o.outcome), o.reason);
  }
  return line;
}

namespace {

template <typename Id>
std::string words_of(const std::vector<Id>& items, const char* when_empty) {
  constexpr std::size_t shown = 20;
  if (items.empty()) return when_empty;
  const auto end = items.begin() + static_cast<std::ptrdiff_t>(std::min(shown, items.size()));
  return fmt::format("{}{}", fmt::join(items.begin(), end, ","),
                     items.size() > shown ? fmt::format(" and {} more", items.size() - shown) : "");
}

}  // namespace

std::string words(const std::vector<discovery::GatewayId>& gateways, const char* when_empty) {
  return words_of(gateways, when_empty);
}
std::string words(const std::vector<discovery::InstanceId>& instances, const char* when_empty) {
  return words_of(instances, when_empty);
}
std::string words(const InstanceSelection& selection) {
  return fmt::format("{} on {}", words(selection.instances, "none"), words(selection.gateways, "any"));
}
std::string words(const DeployRequest& request) {
  return fmt::format("{} of {} on {}", request.count, request.plugin, words(request.gateways, "all"));
}
/// Says how many properties change, but not which, because they may hold secrets.
std::string words(const DeploymentChange& change) {
  return fmt::format("{}{}{}", words(change.instances, "none"),
                     change.properties ? fmt::format(": {} properties", change.properties->size()) : "",
                     change.manager ? fmt::format(", of \"{}\"", *change.manager) : "");
}
std::string words(const GatewaySelection& selection) {
  return words(selection.gateways, "none");
}
std::string words(const UpdateRequest& update) {
  return fmt::format("{} to {}{}{}", words(update.selection),
                     update.plugin.empty() ? "the plugin they have" : update.plugin,
                     update.sha256.empty() ? "" : ", SHA-256 " + update.sha256,
                     update.properties.empty() ? "" : ", with other properties");
}
}  // namespace iotcloud::master
