#include <fmt/format.h>

#include <iotcloud/topology/endpoints/placement/partition_agreement.h>

namespace iotcloud::topology {

namespace {

using Layout = PartitionAgreement::Layout;

/// Whether an instance's messages on two such channels are in units of the same name.
bool meet(const Layout& a, const Layout& b) {
  return a.exclusive == b.exclusive && a.partitions.value_or(1) == b.partitions.value_or(1);
}

/// The end of what is said of a difference.
constexpr const char* or_apart = "; or, if they need not meet, give one of the spouts a \"group\" of its own";

/// For people.
std::string text_of(const Layout& layout) {
  if (layout.exclusive) return "exclusive";
  if (!layout.partitions) return "shared and not split";
  return fmt::format("shared and split into {} partitions", *layout.partitions);
}

}  // namespace

void PartitionAgreement::set(const Source& source, const std::string& channel, const Layout& layout) {
  change(source, channel, layout);
}

void PartitionAgreement::forget(const Source& source, const std::string& channel) {
  change(source, channel, std::nullopt);
}

void PartitionAgreement::change(const Source& source, const std::string& channel, const std::optional<Layout>& layout) {
  const config::MutexLock lock(mutex_);
  const std::string before = difference_of(source);
  auto& channels = layouts_[source];
  if (layout) {
    channels[channel] = *layout;
  } else {
    channels.erase(channel);
  }
  if (channels.empty()) layouts_.erase(source);
  if (difference_of(source) == before) return;
  for (const auto& [number, on_change] : listeners_) on_change();
}

std::string PartitionAgreement::difference(const Source& source) const {
  const config::MutexLock lock(mutex_);
  return difference_of(source);
}

std::string PartitionAgreement::difference_of(const Source& source) const {
  const auto found = layouts_.find(source);
  if (found == layouts_.end()) return {};
  const auto& [first, layout] = *found->second.begin();
  for (const auto& [channel, other] : found->second) {
    if (meet(layout, other)) continue;
    if (layout.partitions && other.partitions) {
      return fmt::format(
          "its topics of the channels \"{}\" and \"{}\" have {} and {} partitions, so messages of one driver would not "
          "meet in one worker; give both topics the same number (kafka-topics.sh --alter --partitions){}",
          first, channel, *layout.partitions, *other.partitions, or_apart);
    }
    return fmt::format(
        "its channels \"{}\" and \"{}\" come to one bolt and are shared out among workers in different ways ({}: {}; "
        "{}: {}), so messages of one driver would not meet in one worker; deploy the driver with both shared or both "
        "exclusive (channel.NAME.shared) and, if shared, on one broker (channel.NAME.broker){}",
        first, channel, first, text_of(layout), channel, text_of(other), or_apart);
  }
  return {};
}

int PartitionAgreement::listen(std::function<void()> on_change) {
  const config::MutexLock lock(mutex_);
  listeners_[++last_listener_] = std::move(on_change);
  return last_listener_;
}

void PartitionAgreement::ignore(int listener) {
  const config::MutexLock lock(mutex_);
  listeners_.erase(listener);
}

}  // namespace iotcloud::topology
