#include <algorithm>
#include <utility>

#include <fmt/ranges.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::DriverRecord;
using discovery::GatewayStatus;
using std::chrono::milliseconds;

namespace {

constexpr config::Logger logger{"master"};
constexpr milliseconds longest_wait{600'000};

}  // namespace

const GatewayStatus* find(const std::vector<GatewayStatus>& gateways, const std::string& id) {
  const auto at = std::find_if(gateways.begin(), gateways.end(), [&](const auto& g) { return g.record.id == id; });
  return at == gateways.end() ? nullptr : &*at;
}

OrderResult refuse(Refusal refusal, std::string text) {
  return {refusal, std::move(text), "", {}};
}

OrderResult refuse_gateway(const std::string& id, const std::vector<GatewayStatus>& known) {
  if (known.empty())
    return refuse(Refusal::unknown_gateway,
                  "no gateway is registered: start iotcloud-gateway with the same registry and zk.root");
  std::vector<std::string> ids;
  for (const auto& gateway : known) ids.push_back(gateway.record.id);
  return refuse(Refusal::unknown_gateway,
                fmt::format("no gateway \"{}\"; known gateways: {}", id, fmt::join(ids, ", ")));
}

void set_verdict(InstanceOutcome& outcome, const std::optional<OutcomeWatch::Verdict>& verdict) {
  if (!verdict) return;
  outcome.outcome = verdict->outcome;
  outcome.reason = verdict->reason;
}

Master::Impl::Impl(discovery::Registry& registry_of_all, MasterOptions given)
    : registry(registry_of_all),
      options(std::move(given)),
      election(registry, options.paths.masters(), options.address,
               {[this](std::int64_t epoch) { logger.info("{} leads, epoch {}", options.id, epoch); },
                [this] { logger.warn("{} does not lead any more", options.id); }}) {}

std::optional<OrderResult> Master::Impl::refuse_unless_leading() const {
  if (election.leading()) return std::nullopt;
  auto result = refuse(Refusal::not_leading, "");
  if (registry.session() != discovery::SessionState::connected) {
    result.refusal = Refusal::registry_away;
    result.text = "the registry is away, so no order can be given; this master keeps trying to reach it";
    return result;
  }
  result.leader = leader();
  result.text = result.leader.empty()
                    ? fmt::format("master {} does not lead and none does yet; try again in a moment", options.id)
                    : fmt::format("master {} is on standby; the one that leads is {}", options.id, result.leader);
  return result;
}

OrderResult Master::Impl::refuse_for(const discovery::RegistryError& error) const {
  if (error.code() != discovery::RegistryErrorCode::fenced)
    return refuse(Refusal::registry_away, fmt::format("the registry did not answer: {}", error.what()));
  auto result = refuse(Refusal::not_leading, lost_lead_text);
  result.leader = election.leader_data();  // it may not have been told yet that it does not lead itself
  return result;
}

milliseconds Master::Impl::limit(const WaitLimit& wait) const {
  return std::clamp(wait.value_or(options.outcome_timeout), milliseconds{0}, longest_wait);
}

void Master::Impl::settle(OrderResult& result, OutcomeWatch& watch, DirectCalls& calls, const WaitLimit& wait,
                          const std::string& order) {
  const auto verdicts = watch.wait(limit(wait), closing.get_token());
  for (auto& outcome : result.outcomes) {
    const auto verdict = verdicts.find(outcome.instance);
    if (verdict != verdicts.end()) set_verdict(outcome, verdict->second);  // the others are known already
  }
  for (auto& call : calls) result.outcomes.push_back(call.get());
  tell(result, order);
}

void Master::Impl::tell(const OrderResult& result, const std::string& order) {
  for (const auto& outcome : result.outcomes) {
    view.ordered(outcome.instance);
    config::process_metrics()
        .counter("iotcloud_master_orders_total", "Orders by what became of them, one for each instance",
                 {{"order", order}, {"outcome", to_string(outcome.outcome)}})
        .add();
  }
  logger.info("{}: {}", order, result.summary());
}

Master::Master(discovery::Registry& registry, MasterOptions options)
    : impl_(std::make_unique<Impl>(registry, std::move(options))) {}

Master::~Master() {
  close();
  std::unique_lock lock(impl_->mutex);
  impl_->idle.wait(lock, [this] { return impl_->under_way == 0; });
}

void Master::close() {
  impl_->closing.request_stop();
}

std::optional<OrderResult> Master::refusal() const {
  return impl_->refuse_unless_leading();
}

std::vector<DriverRecord> Master::drivers() const {
  return impl_->view.list();
}

std::vector<GatewayStatus> Master::gateways() const {
  auto gateways = discovery::list_gateways(impl_->registry, impl_->options.paths);
  for (auto& gateway : gateways) gateway.original = impl_->is_direct(gateway.record.id);
  return gateways;
}

std::vector<discovery::PlacedOrder> Master::orders() const {
  return discovery::list_orders(impl_->registry, impl_->options.paths, {});
}

std::vector<discovery::TopologyStatus> Master::topologies() const {
  return discovery::list_topologies(impl_->registry, impl_->options.paths);
}

MasterStatus Master::status() const {
  MasterStatus status;
  status.id = impl_->options.id;
  const auto lead = impl_->election.lead();
  status.leading = lead.has_value();
  status.epoch = lead ? lead->epoch : 0;
  status.registry_away = impl_->registry.session() != discovery::SessionState::connected;
  if (!status.registry_away) status.leader = impl_->leader();  // else it would be waited for
  return status;
}

}  // namespace iotcloud::master
