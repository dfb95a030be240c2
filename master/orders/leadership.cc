#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/leadership.h>

namespace iotcloud::master {

using discovery::RegistryError;
using discovery::RegistryErrorCode;

OrderResult refuse(OrderRefusal refusal, std::string text) {
  return {refusal, std::move(text), "", {}};
}

Leadership::Leadership(discovery::Registry& registry, const std::string& path, std::string id, std::string address)
    : registry_(registry),
      id_(std::move(id)),
      address_(std::move(address)),
      election_(registry, path, address_,
                {[this](std::int64_t epoch) { logger.info("{} leads, epoch {}", id_, epoch); },
                 [this] { logger.warn("{} does not lead any more", id_); }}) {}

void Leadership::finish() {
  close();
  const config::MutexLock lock(mutex_);
  idle_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return under_way_ == 0; });
}

std::optional<OrderResult> Leadership::refusal() const {
  if (election_.leading()) return std::nullopt;
  if (registry_.session() != discovery::SessionState::connected)
    return refuse(OrderRefusal::registry_away,
                  "the registry is away, so no order can be given; this master keeps trying to reach it");
  auto result = refuse(OrderRefusal::not_leading, "");
  result.leader = leader();
  result.text = result.leader.empty()
                    ? fmt::format("master {} does not lead and none does yet; try again in a moment", id_)
                    : fmt::format("master {} is on standby; the one that leads is {}", id_, result.leader);
  return result;
}

OrderResult Leadership::refusal_for(const RegistryError& error) const {
  if (error.code() != RegistryErrorCode::fenced)
    return refuse(OrderRefusal::registry_away, fmt::format("the registry did not answer: {}", error.what()));
  auto result = refuse(OrderRefusal::not_leading, lost_lead_text);
  result.leader = election_.leader_data();  // not leader(): this master may not know yet that it lost the election
  return result;
}

ReasonedOutcome Leadership::outcome_of(const RegistryError& error) {
  switch (error.code()) {
    case RegistryErrorCode::fenced:
      return {OrderOutcome::failed, lost_lead_text};
    case RegistryErrorCode::away:
      return {OrderOutcome::unknown, fmt::format("whether the order was recorded is not known: {}", error.what())};
    default:
      return {OrderOutcome::failed, error.what()};
  }
}

}  // namespace iotcloud::master
