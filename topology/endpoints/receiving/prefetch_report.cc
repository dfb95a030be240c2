#include <cstdint>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/receiving/prefetch_report.h>

namespace iotcloud::topology {

namespace {

/// How many looks in a row find a limited channel before the prefetch counts as the limit, and after how many more
/// looks the log says it again.
constexpr int limit_looks = 3, limit_repeat = 120;

}  // namespace

void PrefetchReport::look(std::size_t limited, std::size_t most) {
  limited_looks_ = limited > 0 ? limited_looks_ + 1 : 0;
  const bool is_the_limit = limited_looks_ >= limit_looks;
  const config::Labels labels{{"topology", services_->topology.str()}, {"component", component_}};
  auto& metrics = *services_->metrics;
  metrics.gauge("iotcloud_spout_prefetch", "The most unsettled messages that a channel may have now", labels)
      .set(static_cast<std::int64_t>(most));
  metrics
      .gauge("iotcloud_spout_prefetch_limited",
             "Channels of which as many messages as the broker hands out are unsettled, so that the others wait",
             labels)
      .set(is_the_limit ? static_cast<std::int64_t>(limited) : 0);
  const std::string limit = is_the_limit ? text(limited, most) : "";
  services_->held->set_limit(component_, limit);
  if (is_the_limit && (limited_looks_ - limit_looks) % limit_repeat == 0)
    endpoints_logger.warn("{}: {}", component_, limit);
}

std::string PrefetchReport::text(std::size_t limited, std::size_t most) const {
  const auto keepers = services_->keepers.find(component_);
  const bool kept = keepers != services_->keepers.end();
  const std::string mend =
      kept && !own_prefetch_
          ? fmt::format(
                "it was not raised further, because of the memory for such messages ({} MiB) or of the broker; "
                "keep less, or set prefetchCount",
                HeldMessages::usual_limit >> 20U)
          : "set prefetchCount above the number of messages that come in that time";
  return fmt::format(
      "prefetchCount ({}) is the limit: of {} channel(s) so many messages are in the topology, unsettled, and the "
      "others wait at the broker; {}; {}",
      most, limited, kept ? "bolts keep tuples: " + keepers->second : "a bolt acks late", mend);
}

}  // namespace iotcloud::topology
