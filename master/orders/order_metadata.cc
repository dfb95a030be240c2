#include <fmt/format.h>

#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::GatewayStatus;
using discovery::OrderRecord;

OrderResult Master::update_metadata(const InstanceSelection& selection, const MetadataChanges& changes) {
  return impl_->guarded([&] { return impl_->update_metadata(selection, changes); });
}

OrderResult Master::Impl::update_metadata(const InstanceSelection& selection, const MetadataChanges& changes) {
  if (changes.empty()) return refuse(Refusal::bad_request, "nothing is to change: give at least one KEY=VALUE");
  if (changes.contains("")) return refuse(Refusal::bad_request, "a key of metadata has at least one character");
  const auto known = discovery::list_gateways(registry, options.paths);
  std::vector<Located> instances;
  if (auto refusal = find_selected(selection, known, instances)) return *refusal;
  OrderResult result;
  OutcomeWatch watch(registry, options.paths, changes);
  for (const auto& where : instances) {
    InstanceOutcome outcome{where.gateway, where.instance, Outcome::unknown, ""};
    set_verdict(outcome, order_metadata(where, find(known, where.gateway), changes, watch));
    result.outcomes.push_back(std::move(outcome));
  }
  DirectCalls none;
  settle(result, watch, none, selection.wait, "metadata");
  return result;
}

Master::Impl::MaybeVerdict Master::Impl::order_metadata(const Located& where, const GatewayStatus* gateway,
                                                        const MetadataChanges& changes, OutcomeWatch& watch) {
  const auto failed = [](const char* why) { return OutcomeWatch::Verdict{Outcome::failed, why}; };
  if (gateway == nullptr) return failed("its gateway is not registered any more");
  if (is_direct(where.gateway)) return failed("its gateway is of the original system, which takes no metadata");
  if (!gateway->alive && !options.record_for_lost_gateways) return failed(lost_and_not_recorded_text);
  return written([&](const discovery::Lead& lead) -> MaybeVerdict {
    const auto verdict = rewrite_order(where, lead, [&](OrderRecord& order) {
      for (const auto& [key, value] : changes) {
        if (value.empty()) {
          order.metadata.erase(key);
        } else {
          order.metadata[key] = value;
        }
      }
    });
    if (verdict) return verdict;
    if (!gateway->alive) return OutcomeWatch::Verdict{Outcome::pending, lost_text};
    watch.expect(where.instance, where.driver, where.record);
    return std::nullopt;
  });
}

}  // namespace iotcloud::master
