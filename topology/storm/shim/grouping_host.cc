#include <algorithm>
#include <stdexcept>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/storm/shim/component_source.h>
#include <iotcloud/topology/storm/shim/grouping_host.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {

namespace {

TopologyContext complete_context(const TaskDescription& emitter) {
  TopologyContext context = emitter.context();
  context.clock = &config::system_clock();
  context.metrics = &config::process_metrics();
  return context;
}

}  // namespace

GroupingHost::GroupingHost(const TaskDescription& emitter, const std::string& bolt, std::size_t input,
                           std::vector<int> targets)
    : targets_(std::move(targets)), emitter_(complete_context(emitter)), stream_(emitter.outputs.front()) {
  grouping_ = grouping_of(emitter, bolt, input);
  grouping_->prepare(emitter_, stream_.fields, targets_);
}

std::size_t GroupingHost::choose(std::span<const std::byte> values, std::span<std::int32_t> chosen) {
  chosen_.clear();
  std::int64_t birth = 0;
  grouping_->choose(decode_values(values, stream_.births ? &birth : nullptr), chosen_);
  if (chosen_.size() > chosen.size())
    throw std::invalid_argument("the grouping of stream \"" + stream_.stream + "\" chose too many tasks");
  for (const int task : chosen_) {
    if (std::binary_search(targets_.begin(), targets_.end(), task)) continue;
    throw std::invalid_argument("the grouping of stream \"" + stream_.stream + "\" chose task " + std::to_string(task) +
                                ", which does not read it");
  }
  std::copy(chosen_.begin(), chosen_.end(), chosen.begin());
  return chosen_.size();
}

}  // namespace iotcloud::topology::storm
