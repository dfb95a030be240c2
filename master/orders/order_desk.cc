#include <algorithm>

#include <iotcloud/config/metrics.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/direct_gateways.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/orders/order_desk.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master {

using std::chrono::milliseconds;

namespace {

constexpr milliseconds longest_wait{600'000};

}  // namespace

OrderDesk::OrderDesk(discovery::Registry& registry_of_all, MasterOptions given)
    : registry(registry_of_all),
      options(std::move(given)),
      leadership(registry, options.paths.masters(), options.id, options.address) {}

bool OrderDesk::is_direct(const discovery::GatewayId& gateway) const {
  return options.direct != nullptr && options.direct->has(gateway);
}

void OrderDesk::set_outcome(InstanceOutcome& outcome, const EarlyOutcome& early) {
  if (!early) return;
  outcome.outcome = early->outcome;
  outcome.reason = early->reason;
}

EarlyOutcome OrderDesk::obstacle(const LocatedInstance& where, const discovery::GatewayStatus* gateway,
                                 const char* direct_text) const {
  const auto failed = [](const char* why) { return ReasonedOutcome{OrderOutcome::failed, why}; };
  if (gateway == nullptr) return failed("its gateway is not registered any more");
  if (is_direct(where.gateway)) return failed(direct_text);
  if (!gateway->alive && !options.record_for_lost_gateways) return failed(lost_and_not_recorded_text);
  return std::nullopt;
}

milliseconds OrderDesk::limit(const WaitLimit& wait) const {
  return std::clamp(wait.value_or(options.outcome_timeout), milliseconds{0}, longest_wait);
}

void OrderDesk::settle(OrderResult& result, OutcomeWatch& watch, const WaitLimit& wait, const std::string& order,
                       DirectCalls calls) {
  const auto outcomes = watch.wait(limit(wait), leadership.closing());
  for (auto& outcome : result.outcomes) {
    const auto found = outcomes.find(outcome.instance);
    if (found != outcomes.end())
      set_outcome(outcome, found->second);  // instances of which nothing was found here had one before
  }
  for (auto& call : calls) result.outcomes.push_back(call.get());
  tell(result, order);
}

void OrderDesk::tell(const OrderResult& result, const std::string& order) {
  for (const auto& outcome : result.outcomes) {
    view.ordered(outcome.instance);
    config::process_metrics()
        .counter("iotcloud_master_orders_total", "Orders by what became of them, one for each instance",
                 {{"order", order}, {"outcome", to_string(outcome.outcome)}})
        .add();
  }
  logger.info("{}: {}", order, result.summary());
}

std::optional<OrderResult> refuse_plugin(const std::string& plugin, const std::string& sha256) {
  if (!is_node_name(plugin))
    return refuse(OrderRefusal::bad_request,
                  fmt::format("\"{}\" is no plugin: give the name of a file in the gateway's plugin folder, "
                              "such as turtle.so, without its path",
                              plugin));
  if (!sha256.empty() && !security::is_sha256(sha256))
    return refuse(OrderRefusal::bad_request,
                  fmt::format("{}: a SHA-256 has 64 hexadecimal digits in lower case", plugin));
  return std::nullopt;
}

}  // namespace iotcloud::master
