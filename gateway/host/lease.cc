#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/gateway/host/lease.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

std::optional<milliseconds> lease_of(const std::map<std::string, std::string>& properties) {
  const auto policy = properties.find("on_partition");
  const auto lease = properties.find("lease");
  const bool stops = policy != properties.end() && policy->second == "stop";
  if (policy != properties.end() && !stops && policy->second != "continue") {
    throw config::Error(
        fmt::format("the property on_partition: \"{}\" is unknown; give stop or continue", policy->second));
  }
  if (!stops) {
    if (lease == properties.end()) return std::nullopt;
    throw config::Error("the property lease needs on_partition=stop");
  }
  if (lease == properties.end()) throw config::Error("on_partition=stop needs the property lease, for example 30s");
  const auto time = config::parse_duration(lease->second);
  if (!time || *time < milliseconds{1}) {
    throw config::Error(fmt::format("the property lease: \"{}\" is no time; give for example 30s", lease->second));
  }
  return std::chrono::duration_cast<milliseconds>(*time);
}

void check_lease(const std::map<std::string, std::string>& properties, milliseconds session_timeout) {
  const auto lease = lease_of(properties);
  if (!lease || *lease >= session_timeout) return;
  throw config::Error(
      fmt::format("the property lease: {} ms is shorter than the session of its gateway in the registry ({} ms); give "
                  "at least that",
                  lease->count(), session_timeout.count()));
}

bool LeaseConfirmation::renew(config::Clock::Instant at) {
  if (latest_ && at <= *latest_) return false;
  latest_ = at;
  return true;
}

std::chrono::nanoseconds LeaseConfirmation::left(milliseconds lease, config::Clock::Instant now) const {
  if (!latest_) return std::chrono::nanoseconds{0};
  return std::max<std::chrono::nanoseconds>(*latest_ + lease - now, std::chrono::nanoseconds{0});
}

}  // namespace iotcloud::gateway
