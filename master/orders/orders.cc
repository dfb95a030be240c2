#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

std::string to_string(Outcome outcome) {
  switch (outcome) {
    case Outcome::done:
      return "done";
    case Outcome::failed:
      return "failed";
    case Outcome::pending:
      return "pending";
    case Outcome::unknown:
      return "unknown";
  }
  return "unknown";
}

std::string to_string(Change change) {
  switch (change) {
    case Change::undeploy:
      return "undeploy";
    case Change::start:
      return "start";
    case Change::stop:
      return "stop";
  }
  return "";
}

bool OrderResult::all_done() const {
  return refusal == Refusal::none &&
         std::all_of(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == Outcome::done; });
}

std::string OrderResult::summary() const {
  if (refusal != Refusal::none) return text;
  const auto done =
      std::count_if(outcomes.begin(), outcomes.end(), [](const auto& o) { return o.outcome == Outcome::done; });
  auto line = fmt::format("{} of {} done", done, outcomes.size());
  // A text for people: what went wrong first, not ten thousand lines of it.
  constexpr int shown_at_most = 5;
  int shown = 0;
  for (const auto& o : outcomes) {
    if (o.outcome == Outcome::done) continue;
    if (shown++ == shown_at_most) return line + "; ...";
    line += fmt::format("; {} on {}: {}: {}", o.instance, o.gateway, to_string(o.outcome), o.reason);
  }
  return line;
}

}  // namespace iotcloud::master
